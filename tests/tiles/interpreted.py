"""The Triton kernels on the CPU, run by tests/tiles/test_tiles.py in a process with TRITON_INTERPRET=1.

Errors are measured as in the tests of the compiled kernels, whose cases these are.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import torch
from torch import Tensor

from sgmethod.backend import tiles
from sgmethod.backend.devices import has_tiles
from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import TARGET_WHITE, Frame, Moments
from sgmethod.backend.reference import Reference
from sgmethod.backend.tensors import Tensors
from sgmethod.backend.tiles import Fits, Tiles
from sgmethod.scene import FloatArray, Gaussians
from sgmethod.settings.rd import NEWTON_ADAM
from sgmethod.settings.shared import ADAM, OptimiserSettings
from tests.backend.cases import FRAMES, SIZE, VISIBILITIES, image, over, scattered, target, visibility, worst
from tests.native import test_pyramid as pyramid
from tests.native import test_render as plain

CPU = torch.device("cpu")


@pytest.fixture(autouse=True)
def no_warnings() -> Iterator[None]:
    """Numpy, which interprets the kernels, warns where values overflow; a GPU does not."""
    with np.errstate(all="ignore"):
        yield


@pytest.fixture(params=["lists", "no lists"])
def lists(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """With and without room in the lists of tiles."""
    monkeypatch.setattr(tiles, "PAIRS", 8 if request.param == "lists" else 0)
    return str(request.param)


def tensors(gaussians: Gaussians) -> list[Tensor]:
    return [torch.from_numpy(values)[None] for values in gaussians.arrays]


@pytest.mark.parametrize("name", [*pyramid.CASES, "needles"])
def test_pyramid(name: str, lists: str) -> None:
    c = pyramid.needle_case((83, 70)) if name == "needles" else pyramid.case(name)
    drawn = Tiles(Frame(*c.size), *tensors(c.values))
    assert np.abs(drawn.draw()[0].numpy() - c.picture).max() < 1e-5  # worst seen 6.2e-6
    if lists == "lists":
        for found, true in zip(drawn.gradients(torch.from_numpy(c.upstream)[None]), c.by_picture, strict=True):
            error = np.abs(found[0].numpy() - true)
            assert (error < 1e-5 * np.abs(true).max(initial=0)).all()  # worst seen 1.6e-6


def test_needles_each() -> None:
    """In parts of each needle's own gradient, as in tests/native/test_pyramid.py."""
    c = pyramid.needle_case((83, 70))
    found = [
        by[0].numpy() for by in Tiles(Frame(*c.size), *tensors(c.values)).gradients(torch.from_numpy(c.upstream)[None])
    ]
    for by, true in zip(found, c.by_picture, strict=True):
        assert (np.linalg.norm(by - true, axis=1) < 4e-4 * np.linalg.norm(true, axis=1)).all()  # worst seen 6.6e-5
    own, true = (pyramid.in_frame(c.values.factors, *by[:2]) for by in (found, c.by_picture))
    assert (np.abs(own - true).max(0) < 0.02 * np.abs(true).max(0)).all()


@pytest.mark.parametrize("name", plain.CASES)
def test_plain(name: str) -> None:
    c, sizes, (picture, gradients) = plain.case(name), plain.magnitudes_of(name), plain.reference_of(name)
    frame = Frame(*c.size, plain.CUTOFF, pyramid=False)
    drawn = Tiles(frame, c.means[None], c.factors[None], c.colors[None])
    assert ((drawn.draw()[0] - picture).abs().numpy() <= plain.VALUE_TOLERANCE * sizes.picture).all()
    every = zip(drawn.gradients(c.upstream[None]), gradients, sizes.gradients, sizes.rim, strict=True)
    for found, true, size, rim in every:
        assert ((found[0] - true).abs().numpy() <= plain.GRADIENT_TOLERANCE * size + rim).all()


@pytest.mark.parametrize(("name", "kind"), [*zip(FRAMES, (*VISIBILITIES, "eye", "alpha"), strict=True)])
def test_backend(name: str, kind: str) -> None:
    frame, reference, backend = FRAMES[name], Reference(), Tensors(CPU, has_tiles(CPU))
    asked = over(frame, 1), frame, target(1), visibility(kind, 1)
    assert type(backend._drawn(asked[0], frame)[0]) is Tiles
    error, gradient = backend.gradients(*asked)
    wanted_error, wanted = reference.gradients(*asked)
    assert error == pytest.approx(wanted_error, rel=3e-6)
    assert all(worst(*pair) < 1e-5 for pair in zip(gradient.arrays, wanted.arrays, strict=True))
    loss, exact = (each.regularised(frame, image(1), 0.06) for each in (backend, reference))
    for by, wanted_by in zip(loss(asked[0])[1].arrays, exact(asked[0])[1].arrays, strict=True):
        assert worst(by, wanted_by) < 1e-5
    gram = backend.gram(asked[0], frame, asked[3])
    assert worst(gram, reference.gram(asked[0], frame, asked[3])) < 1e-5


def test_a_batch_is_its_pictures() -> None:
    """What cannot be drawn draws nothing, gets no gradient and disturbs no other."""
    every = [scattered(9, seed) for seed in range(3)]
    every[1].factors[:4, ::2] = np.float32([[0, 1], [-1, 1], [np.nan, 1], [1e-30, 1]])
    every[1].means[4:6] = np.float32([[np.inf, 0], [0, np.nan]])
    frame, by_image = Frame(*SIZE), torch.from_numpy(np.stack([image(seed) for seed in range(3)]))
    batch = Tiles(frame, *(torch.cat(values) for values in zip(*map(tensors, every), strict=True)))
    pictures, gradients = batch.draw(), batch.gradients(by_image)
    assert all(not by[1, :6].any() for by in gradients)
    for k, one in enumerate(every):
        some = one.rows(np.arange(6, 9)) if k == 1 else one
        alone = Tiles(frame, *tensors(some))
        assert torch.equal(alone.draw()[0], pictures[k])
        for found, wanted in zip(gradients, alone.gradients(by_image[k : k + 1]), strict=True):
            assert torch.equal(found[k, -len(some) :], wanted[0])


@pytest.mark.parametrize("shape", [(0, 5), (2, 0)])
def test_nothing_to_draw(shape: tuple[int, int]) -> None:
    drawn = Tiles(Frame(20, 33), *(torch.ones(*shape, k) for k in (2, 3, 3)))
    assert drawn.draw().shape == (shape[0], 3, 33, 20)
    assert not drawn.draw().any()
    assert [by.shape for by in drawn.gradients(torch.ones(shape[0], 3, 33, 20))] == [(*shape, k) for k in (2, 3, 3)]


def step_of_kernels(
    gaussians: Gaussians, moments: Moments, frame: Frame, wanted: FloatArray, settings: OptimiserSettings, price: float
) -> float:
    """One step of a fit as profile rd takes it, on the CPU."""
    kernels, size = Kernels(), (frame.width * frame.spacing, frame.height * frame.spacing)
    samples = 3 * size[0] * size[1]
    levels = np.asarray(np.round(wanted * TARGET_WHITE), np.int16)
    error, gradient = kernels.gradients(gaussians, frame, levels)
    kernels.add_rate_gradient(gaussians, gradient, 0.3, price / samples)
    kernels.step(gaussians, gradient, moments, settings, 0.5, samples)
    kernels.keep_in_range(gaussians, *size)
    return error


@pytest.mark.parametrize(("settings", "spacing"), [(NEWTON_ADAM, 1), (ADAM, 2)])
def test_steps(settings: OptimiserSettings, spacing: int) -> None:
    """Two pictures at once, each at its own price, beside the kernels; one has fewer Gaussians, and then more come."""
    frame = Frame(*SIZE, spacing=spacing)
    size = frame.width * spacing, frame.height * spacing
    every, prices = [over(frame, 0).rows(np.arange(12)), over(frame, 1).rows(np.arange(8))], (1e-3, 2e-2)
    every[0].factors[0] = (9000, 0, 8000)  # out of range
    every[0].colors[1] = 0
    moments, wanted = [Moments.none(len(one)) for one in every], [image(0), image(1)]
    filled = [[torch.nn.functional.pad(v, (0, 0, 0, 12 - v.shape[1])) for v in tensors(one)] for one in every]
    fits = Fits(size, settings, *(torch.cat(values) for values in zip(*filled, strict=True)))
    levels = torch.from_numpy(np.round(np.stack(wanted) * TARGET_WHITE) / np.float32(TARGET_WHITE))
    for number in range(4):
        if number == 2:
            new = scattered(3, 7, size)
            fits.add(*(values.expand(2, -1, -1) for values in tensors(new)))
            fits.keep(torch.tensor([[*range(1, 15)], [*range(8), *range(12, 15), 8, 9, 10]]))
            rows = np.arange(1, 12)
            every = [every[0].rows(rows).with_more(new), every[1].with_more(new)]
            moments = [moments[0].rows(rows).with_more(3), moments[1].with_more(3)]
        errors = fits.step(levels, spacing, 0.5, torch.full((2,), 0.3), torch.tensor(prices))
        for k, (one, beside, price) in enumerate(zip(every, moments, prices, strict=True)):
            error = step_of_kernels(one, beside, frame, wanted[k], settings, price)
            assert errors[k].item() == pytest.approx(error, rel=1e-5)
            for found, true in zip((fits.means, fits.factors, fits.colors), one.arrays, strict=True):
                assert worst(found[k, : len(one)].numpy(), true) < 1e-5
                assert not found[k, len(one) :].any()
    assert torch.equal(fits.draw(*SIZE, spacing), Tiles(frame, fits.means, fits.factors, fits.colors).draw())
