"""The Triton kernels on the CPU, run by tests/torch/test_tiles.py in a process with TRITON_INTERPRET=1.

So are the scenes of tests/drawing and the frames of tests/backend.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from threading import Event

import numpy as np
import pytest
import torch
from torch import Tensor

from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Descent, Frame, Moments
from sgmethod.fitting.deadline import Clock
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import NEWTON_ADAM
from sgmethod.settings.shared import ADAM, OptimiserSettings
from sgmethod.torch import tiles
from sgmethod.torch.batched import BatchedTensors
from sgmethod.torch.exact import ExactFit
from sgmethod.torch.fitting import fit_pictures
from sgmethod.torch.tiles import Tiles
from tests.backend.cases import SIZE, image, over, scattered, target, worst
from tests.drawing.renderers import by_tiles
from tests.drawing.scenes import PYRAMIDS, SCENES, exact

CPU = torch.device("cpu")


@pytest.fixture(autouse=True)
def no_warnings() -> Iterator[None]:
    """Numpy, which interprets the kernels, warns where values overflow; a GPU does not."""
    with np.errstate(all="ignore"):
        yield


def tensors(gaussians: Gaussians) -> list[Tensor]:
    return [torch.from_numpy(values)[None] for values in gaussians.arrays]


@pytest.mark.parametrize("name", PYRAMIDS)
def test_no_space_in_the_lists_of_tiles(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiles, "PAIRS", 0)
    picture, _ = by_tiles(SCENES[name])
    assert np.abs(picture - exact(name).picture).max() < 1e-5  # worst seen 6.2e-6


def test_a_batch_is_its_pictures() -> None:
    """What cannot be drawn draws nothing, gets no gradient and disturbs no other."""
    every = [scattered(9, seed) for seed in range(3)]
    every[1].factors[:4, ::2] = np.array([[0, 1], [-1, 1], [np.nan, 1], [1e-30, 1]], np.float32)
    every[1].means[4:6] = np.array([[np.inf, 0], [0, np.nan]], np.float32)
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


@pytest.mark.parametrize(("settings", "spacing"), [(NEWTON_ADAM, 1), (ADAM, 2)])
def test_steps(settings: OptimiserSettings, spacing: int) -> None:
    """Two pictures at once, each at its own price, which may be none, beside the kernels; one has fewer."""
    frame = Frame(*SIZE, spacing=spacing)
    size = frame.width * spacing, frame.height * spacing
    every, prices = [over(frame, 0).rows(np.arange(12)), over(frame, 1).rows(np.arange(8))], (0.0, 2e-6)
    every[0].factors[0] = (9000, 0, 8000)  # out of range
    every[0].colors[1] = 0
    fits = [
        (one, Moments.none(len(one)), Descent(frame, target(k), None, 0.3 * (price > 0), price, *size, settings))
        for k, (one, price) in enumerate(zip(every, prices, strict=True))
    ]
    wanted = [(one.copy(), moments.copy(), descent) for one, moments, descent in fits]
    for _ in range(2):
        BatchedTensors(CPU, 1, Event()).steps_of(fits, (0.5, 0.4))
        for (found, moments, _), beside in zip(fits, wanted, strict=True):
            Kernels().steps(*beside, (0.5, 0.4))
            for own, true in zip((*found.arrays, moments.first), (*beside[0].arrays, beside[1].first), strict=True):
                assert worst(own, true) < 2e-5


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # in threads, which no_warnings() does not reach
def test_fits_of_a_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their steps are taken together, and they end near those of the kernels; an error of one ends all."""
    batches: list[int] = []
    steps_of = BatchedTensors.steps_of

    def counted(
        own: BatchedTensors, fits: Sequence[tuple[Gaussians, Moments, Descent]], rates: Sequence[float]
    ) -> None:
        batches.append(len(fits))
        steps_of(own, fits, rates)

    monkeypatch.setattr(BatchedTensors, "steps_of", counted)
    pictures = [np.asarray(255 * (0.5 + 0.5 * image(k)).clip(0, 1), np.uint8).transpose(1, 2, 0) for k in range(3)]
    task = ExactFit(12, steps=5)
    found = fit_pictures(pictures, task, CPU)
    assert max(batches) == 3
    for one, picture in zip(found, pictures, strict=True):
        wanted = task.fit(picture, Kernels(), Clock(), lambda _: None)
        assert one.error == pytest.approx(wanted.error, rel=0.1)
        assert len(one.gaussians) == 12

    def fail(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(BatchedTensors, "steps_of", fail)
    with pytest.raises(MemoryError):
        fit_pictures(pictures, task, CPU)
