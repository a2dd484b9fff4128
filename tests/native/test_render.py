"""The native kernels, on every instruction set here, against tests.definitions.drawing in float64.

An error is measured against the sum of the magnitudes of what was added up: the only scale on which single
precision promises anything where large terms cancel, as they do along a sheared needle.

The slope of the weight jumps at the rim sigma = CUTOFF, and rounding decides on which side a pixel falls that
lies on it. Such pixels (those with |sigma - CUTOFF| < RIM) may count for a gradient or not; a test holds that they
are too few to hide anything else.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from sgmethod.native import native
from tests.definitions import drawing

CUTOFF = native.CUTOFF_V1
ISAS = range(native.best_isa() + 1)
VALUE_TOLERANCE = 1e-5  # worst seen 4.3e-6, from the recurrence down a column
GRADIENT_TOLERANCE = 5e-6  # worst seen 1.8e-6
RIM = 1e-5  # the worst error of a weight is that of sigma there


@dataclass(frozen=True)
class Case:
    """Gaussians in float32, a picture's size, and a gradient by the picture [3, height, width]."""

    means: Tensor
    factors: Tensor
    colors: Tensor
    size: tuple[int, int]
    upstream: Tensor


def scattered(n: int, size: tuple[int, int], l1: tuple[float, float], l3: tuple[float, float], shear: float) -> Case:
    """n Gaussians in and around a picture; l1 and l3 log-uniform in pixels, l2 up to shear times l3."""
    rng = np.random.default_rng(n + 7 * size[0] + size[1])
    means = rng.uniform(-0.3, 1.3, (n, 2)) * size
    first, third = np.exp(rng.uniform(*np.log(l1), n)), np.exp(rng.uniform(*np.log(l3), n))
    factors = np.stack([first, rng.uniform(-shear, shear, n) * third, third], 1)
    arrays = means, factors, rng.normal(0, 1, (n, 3)), rng.normal(0, 1, (3, size[1], size[0]))
    means, factors, colors, upstream = (torch.tensor(a, dtype=torch.float32) for a in arrays)
    return Case(means, factors, colors, size, upstream)


def on_centres(c: Case) -> Case:
    """c with its means within a tenth of a pixel of pixel centres."""
    return replace(c, means=c.means.floor() + 0.5 + 0.1 * (c.means - c.means.floor() - 0.5))


def moved(c: Case, pixels: float) -> Case:
    return replace(c, means=c.means + pixels)


CASES = {
    "all sizes": lambda: scattered(80, (100, 70), (0.3, 100), (0.3, 100), 1),
    "strong shear": lambda: scattered(60, (75, 130), (0.3, 30), (0.3, 30), 30),
    "needles along x": lambda: scattered(60, (90, 65), (5, 100), (0.3, 0.5), 1),
    "needles along y": lambda: scattered(60, (90, 65), (0.3, 0.5), (5, 100), 1),
    "diagonal needles": lambda: scattered(60, (90, 65), (5, 50), (0.3, 0.5), 100),
    "thinner than pixels": lambda: on_centres(scattered(300, (24, 66), (0.01, 0.3), (0.01, 0.3), 3)),
    "specks": lambda: scattered(400, (64, 64), (0.3, 1), (0.3, 1), 1),
    "whole tiles": lambda: scattered(40, (2 * native.TILE_WIDTH, 2 * native.TILE_HEIGHT), (0.5, 20), (0.5, 20), 1),
    "one more than tiles": lambda: scattered(40, (native.TILE_WIDTH + 1, native.TILE_HEIGHT + 1), (1, 20), (1, 20), 1),
    "one pixel": lambda: scattered(30, (1, 1), (0.3, 10), (0.3, 10), 1),
    "one row": lambda: scattered(60, (4096, 1), (0.3, 100), (0.3, 100), 2),
    "one column": lambda: scattered(60, (1, 4096), (0.3, 100), (0.3, 100), 2),
    "outside": lambda: moved(scattered(30, (20, 20), (1, 2), (1, 2), 1), -500),
    "none": lambda: scattered(0, (33, 17), (1, 2), (1, 2), 1),
}


@cache
def case(name: str) -> Case:
    return CASES[name]()


@cache
def reference_of(name: str) -> tuple[Tensor, list[Tensor]]:
    """The picture and the gradients by means, factors and colours, in float64."""
    c = case(name)
    leaves = [t.double().requires_grad_() for t in (c.means, c.factors, c.colors)]
    picture = drawing.render(leaves[0], leaves[1], leaves[2], c.size, CUTOFF)
    if not len(c.means):
        return picture.detach(), [torch.zeros_like(leaf) for leaf in leaves]
    return picture.detach(), list(torch.autograd.grad(picture, leaves, c.upstream.double()))


@dataclass(frozen=True)
class Magnitudes:
    """What errors are measured against, in float64: for the picture [3, H, W]; for the gradients by mean [N, 2],
    factor [N, 3] and colour [N, 3]; and the part of those gradients that comes from pixels on a rim."""

    picture: NDArray[np.float64]
    gradients: list[NDArray[np.float64]]
    rim: list[NDArray[np.float64]]


@cache
def magnitudes_of(name: str) -> Magnitudes:
    """Sums over |each term|, a term's magnitude being grown by what its own rounding does to it: z2 is the sum of
    dy / l3 and -shear dx / l3, so with t = |dy / l3| + |shear dx / l3| an error of t enters z2, and |z2| t sigma."""
    c = case(name)
    width, height = c.size
    x, y = np.arange(width)[None, :] + 0.5, np.arange(height)[:, None] + 0.5
    picture = np.zeros((3, height, width))
    gradients, rims = ([np.zeros((len(c.means), k)) for k in (2, 3, 3)] for _ in range(2))
    up = np.abs(c.upstream.double().numpy())
    rows = zip(*(t.double().numpy() for t in (c.means, c.factors, c.colors.abs())), strict=True)
    for i, (mean, (l1, l2, l3), color) in enumerate(rows):
        dx, dy, shear = x - mean[0], y - mean[1], abs(l2 / l1)
        z1, z2 = np.abs(dx / l1), np.abs(dy - l2 / l1 * dx) / l3
        t = (np.abs(dy) + shear * np.abs(dx)) / l3
        sigma, grown = (z1 * z1 + z2 * z2) / 2, 1 + z2 * t
        e = np.exp(-sigma) * (sigma < CUTOFF + RIM * grown)
        z2_once, z2_twice = z2 * grown + t, z2 * z2 * grown + 2 * z2 * t
        by_l2 = z1 * z2_once / l3
        terms = [
            z1 * grown / l1 + z2_once * shear / l3,
            z2_once / l3,
            z1 * z1 * grown / l1 + by_l2 * shear,
            by_l2,
            z2_twice / l3,
        ]
        on_rim = np.abs(sigma - CUTOFF) < RIM * grown
        slope = np.tensordot(color, up, 1) * e
        for target, mask in ((gradients, True), (rims, on_rim)):
            geometry = [(slope * term * mask).sum() for term in terms]
            target[0][i], target[1][i] = geometry[:2], geometry[2:]
        gradients[2][i] = (up * e * grown).sum((1, 2))
        picture += color[:, None, None] * e * grown
    return Magnitudes(picture, gradients, rims)


def native_picture(c: Case, isa: int) -> Tensor:
    picture = torch.full((3, c.size[1], c.size[0]), torch.nan)
    native.Rasterization(c.means, c.factors, *c.size, isa=isa).render(c.colors, picture)
    return picture


def native_gradients(c: Case, isa: int) -> list[Tensor]:
    out = [torch.full_like(t, torch.nan) for t in (c.means, c.factors, c.colors)]
    native.Rasterization(c.means, c.factors, *c.size, isa=isa).backward(c.colors, c.upstream, *out)
    return out


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("name", CASES)
def test_values(name: str, isa: int) -> None:
    error = (native_picture(case(name), isa) - reference_of(name)[0]).abs().numpy()
    assert (error <= VALUE_TOLERANCE * magnitudes_of(name).picture).all()


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("name", CASES)
def test_gradients(name: str, isa: int) -> None:
    sizes, found = magnitudes_of(name), native_gradients(case(name), isa)
    for mine, true, size, rim in zip(found, reference_of(name)[1], sizes.gradients, sizes.rim, strict=True):
        error = (mine - true).abs().numpy()
        assert (error <= GRADIENT_TOLERANCE * size + rim).all()


def test_pictures_have_something_and_few_gradients_are_excused_by_a_rim() -> None:
    for name in CASES:
        assert bool(reference_of(name)[0].any()) != (name in ("outside", "none")), name
        sizes = magnitudes_of(name)
        for size, rim in zip(sizes.gradients[:2], sizes.rim[:2], strict=True):
            if size.size:
                assert (rim > 0).any(1).mean() < 0.1


@pytest.mark.parametrize("name", CASES)
def test_pixels_do_not_depend_on_instruction_set_and_threads(name: str, set_threads: Callable[[int], None]) -> None:
    c = case(name)
    expected = native_picture(c, 0)
    bytes_expected = torch.floor(expected.clamp(0, 1) * 255 + 0.5).permute(1, 2, 0).to(torch.uint8).contiguous()
    for threads in (1, 2, 5):
        set_threads(threads)
        for isa in ISAS:
            assert torch.equal(native_picture(c, isa), expected)
            found = torch.full_like(bytes_expected, 77)
            native.Rasterization(c.means, c.factors, *c.size, isa=isa).render_bytes(c.colors, found)
            assert torch.equal(found, bytes_expected)


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("name", CASES)
def test_gradients_do_not_depend_on_threads(name: str, isa: int, set_threads: Callable[[int], None]) -> None:
    set_threads(1)
    expected = native_gradients(case(name), isa)
    for threads in (2, 5):
        set_threads(threads)
        for mine, one in zip(native_gradients(case(name), isa), expected, strict=True):
            assert torch.equal(mine, one)


@pytest.mark.parametrize("isa", ISAS)
def test_a_weight_ends_at_the_cut_off(isa: int) -> None:
    scale = 4.0
    c = Case(
        torch.tensor([[50.5, 50.5]]),
        torch.tensor([[scale, 0, scale]]),
        torch.ones(1, 3),
        (101, 101),
        torch.zeros(3, 101, 101),
    )
    row = native_picture(c, isa)[0, 50]
    reach = scale * np.sqrt(2 * CUTOFF)
    lit = np.flatnonzero(row.numpy()) - 50
    assert lit.min() == -np.floor(reach)
    assert lit.max() == np.floor(reach)
    assert row[50].item() == pytest.approx(1 - np.exp(-CUTOFF), abs=1e-6)  # worst seen 0


ABSURD = """
import itertools, numpy as np
from sgmethod.native import native
sizes = (1e-38, 1e-30, 1e-18, 1e-9, 1.0, 1e9, 1e18, 1e19, 1e20, 1e30, 3e38)
ends = (-3e38, -1e20, -1e9, 8.0, 1e9, 1e20, 3e38)
geometry = itertools.chain(
    itertools.product((8.0,), (8.0,), sizes, (*(-s for s in sizes), 0.0, *sizes), sizes),
    itertools.product(ends, ends, (1.0, 1e20), (0.0, 1e20), (1.0, 1e20)),
)
image, out = np.empty((3, 70, 40), np.float32), [np.empty((1, k), np.float32) for k in (2, 3, 3)]
color = np.ones((1, 3), np.float32)
for (x, y, l1, l2, l3), pyramid in itertools.product(geometry, (False, True)):
    mean, factor = np.float32([[x, y]]), np.float32([[l1, l2, l3]])
    raster = native.Rasterization(mean, factor, 40, 70, max_pairs=100, pyramid=pyramid)
    raster.render(color, image)
    assert np.isfinite(image).all() and image.min() >= 0, (x, y, l1, l2, l3)
    assert image.max() <= (1.03 if pyramid else 1), (x, y, l1, l2, l3)
    raster.backward(color, image, *out)
"""


def test_absurd_but_finite_geometry_does_no_harm() -> None:
    done = subprocess.run([sys.executable, "-c", ABSURD], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr


def test_too_many_pairs_are_refused() -> None:
    c = case("all sizes")
    with pytest.raises(OverflowError, match="too many pairs"):
        native.Rasterization(c.means, c.factors, *c.size, max_pairs=len(c.means))


def test_other_shapes_and_types_are_refused() -> None:
    means, factors, colors = torch.ones(4, 2), torch.ones(4, 3), torch.ones(4, 3)
    picture = torch.empty(3, 70, 40)
    for arguments in ((means[:3], factors, 40, 70), (means, factors[:3], 40, 70), (means, factors, 0, 70)):
        with pytest.raises(ValueError, match=r"differ in number|must have pixels"):
            native.Rasterization(*arguments)
    for arguments in ((factors, factors, 40, 70), (means, means, 40, 70), (means[0], factors, 40, 70)):
        with pytest.raises(TypeError):
            native.Rasterization(*arguments)
    with pytest.raises(ValueError, match="instruction set"):
        native.Rasterization(means, factors, 40, 70, isa=native.best_isa() + 1)
    raster = native.Rasterization(means, factors, 40, 70)
    for call, arguments in (
        (raster.render, (colors[:3], picture)),
        (raster.render, (colors, torch.empty(3, 69, 40))),
        (raster.render_bytes, (colors, torch.empty(70, 41, 3, dtype=torch.uint8))),
        (raster.backward, (colors, picture, means[:3], factors, colors)),
        (raster.backward, (colors, torch.empty(3, 70, 39), means, factors, colors)),
        (raster.squared_error, (colors, np.empty((3, 70, 39), np.int16), means, factors, colors)),
    ):
        with pytest.raises(ValueError, match=r"one colour|one row|another size"):
            call(*arguments)
    for call, arguments in (
        (raster.render, (colors, picture[:1])),
        (raster.render, (colors, picture[0])),
        (raster.render_bytes, (colors, torch.empty(70, 40, 4, dtype=torch.uint8))),
        (raster.backward, (colors, picture, factors, factors, colors)),
        # An output that is no contiguous array of the right type would be converted, and the result be lost.
        (raster.render, (colors, torch.zeros(3, 70, 40, dtype=torch.float64))),
        (raster.render, (colors, torch.zeros(3, 70, 80)[:, :, ::2])),
        (raster.render_bytes, (colors, torch.zeros(70, 40, 3, dtype=torch.int32))),
        (raster.backward, (colors, picture, torch.zeros(4, 2).double(), factors, colors)),
        (raster.backward, (colors, picture, torch.zeros(4, 4)[:, ::2], factors, colors)),
    ):
        with pytest.raises(TypeError):
            call(*arguments)
