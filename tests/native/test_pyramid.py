"""Drawing in a pyramid, on every instruction set here, against sgmethod.native.drawing.render_pyramid in float64; and
needles, which stay on the finest level however long they are.

An error of the picture is absolute, 1 being full white. One of a gradient is in parts of the largest of its kind.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from sgmethod.native import native
from sgmethod.scene import FloatArray, Gaussians
from tests.backend.cases import single
from tests.definitions import drawing

CUTOFF = native.CUTOFF_V2
ISAS = range(native.best_isa() + 1)
VALUE_TOLERANCE = 1e-5  # worst seen 3.9e-6
ERROR_TOLERANCE = 3e-6  # of the mean squared error, in parts of it; worst seen 6.6e-7
GRADIENT_TOLERANCE = 1e-5  # worst seen 4.3e-6

Size = tuple[int, int]
Arrays = tuple[FloatArray, FloatArray, FloatArray]


def scattered(size: Size, n: int, widest: float, seed: int) -> Gaussians:
    """n Gaussians in and around a picture, of sizes from 0.4 pixels up."""
    rng = np.random.default_rng(seed)
    means = rng.uniform(-0.2, 1.2, (n, 2)) * size
    scale, stretch = np.exp(rng.uniform(np.log(0.4), np.log(widest), n)), np.exp(rng.uniform(-1, 1, n))
    l1, l3 = np.maximum(scale * stretch, 0.3), np.maximum(scale / stretch, 0.3)
    return single(means, np.stack([l1, rng.uniform(-1, 1, n) * scale, l3], 1), rng.uniform(-1, 1, (n, 3)))


def of_every_level(size: Size) -> Gaussians:
    scale = 1.5 * drawing.NARROWEST * np.repeat(2.0 ** np.arange(drawing.MAX_LEVEL + 1), 3)
    rng, n = np.random.default_rng(1), len(scale)
    factors = np.stack([scale, rng.uniform(-0.2, 0.2, n) * scale, scale], 1)
    return single(rng.uniform(-0.2, 1.2, (n, 2)) * size, factors, rng.uniform(-1, 1, (n, 3)))


def at_thresholds() -> Gaussians:
    """On both sides of where each level begins, round and slanted: the wrong level would be off by 2 %."""
    factors = []
    for level in range(1, 6):
        minor = drawing.NARROWEST * 2**level
        for side in (1 - 1e-6, 1 + 1e-6):
            factors += [[minor * side, 0, minor * side], turned(5 * minor, minor * side)]
    means = np.random.default_rng(0).uniform(0, 60, (len(factors), 2))
    return single(means, factors, np.full((len(factors), 3), 0.7))


def turned(major: float, minor: float) -> list[float]:
    """The factor of an ellipse whose major axis lies at 45 degrees."""
    l1 = float(np.sqrt((major**2 + minor**2) / 2))
    return [l1, (major**2 - minor**2) / 2 / l1, major * minor / l1]


CASES = {
    "not of whole tiles": ((83, 70), lambda size: scattered(size, 60, 60, 1)),
    "of several tiles": ((200, 131), lambda size: scattered(size, 60, 60, 1)),
    "one pixel": ((1, 1), lambda size: scattered(size, 5, 60, 0)),
    "one row": ((33, 1), lambda size: scattered(size, 10, 60, 0)),
    "narrow": ((5, 300), lambda size: scattered(size, 20, 60, 2)),
    "all levels": ((40, 30), of_every_level),
    "thresholds": ((60, 60), lambda _: at_thresholds()),
    "none": ((33, 17), lambda size: scattered(size, 0, 60, 0)),
}


@dataclass(frozen=True)
class Case:
    """Gaussians over a picture, a target and a gradient by the picture [3, H, W]; and in float64 the picture, its mean
    squared error, and the gradients of that and from above by means, factors and colours."""

    values: Gaussians
    size: Size
    target: NDArray[np.int16]
    upstream: FloatArray
    picture: NDArray[np.float64]
    error: float
    by_error: list[NDArray[np.float64]]
    by_picture: list[NDArray[np.float64]]

    def arrays(self) -> Arrays:
        return self.values.means, self.values.factors, self.values.colors


@cache
def case(name: str) -> Case:
    size, make = CASES[name]
    return case_of(make(size), size)


def case_of(values: Gaussians, size: Size) -> Case:
    rng = np.random.default_rng(9)
    shape = 3, size[1], size[0]
    target = np.round(rng.random(shape) * native.TARGET_WHITE).astype(np.int16)
    upstream = rng.standard_normal(shape).astype(np.float32)
    leaves = [
        torch.tensor(a, dtype=torch.float64, requires_grad=True) for a in (values.means, values.factors, values.colors)
    ]
    picture = drawing.render_pyramid(leaves[0], leaves[1], leaves[2], size, CUTOFF)
    error = (picture - torch.from_numpy(target) / native.TARGET_WHITE).square().mean()
    scalars = (error, (picture * torch.from_numpy(upstream)).sum()) if len(values) else ()
    found = [[g.numpy() for g in torch.autograd.grad(s, leaves, retain_graph=True)] for s in scalars]
    by_error, by_picture = found or [[np.zeros((0, k)) for k in (2, 3, 3)]] * 2
    return Case(values, size, target, upstream, picture.detach().numpy(), error.item(), by_error, by_picture)


def rasterised(c: Case, isa: int) -> native.Rasterization:
    return native.Rasterization(c.values.means, c.values.factors, *c.size, CUTOFF, isa, pyramid=True)


def native_picture(c: Case, isa: int) -> FloatArray:
    picture = np.full(c.target.shape, np.nan, np.float32)
    rasterised(c, isa).render(c.values.colors, picture)
    return picture


def native_gradients(c: Case, isa: int) -> tuple[float, Arrays, Arrays]:
    """The mean squared error and its gradients; and those by the picture."""
    by_error, by_picture = (tuple(np.full_like(a, np.nan) for a in c.arrays()) for _ in range(2))
    error = rasterised(c, isa).squared_error(c.values.colors, c.target, *by_error)
    rasterised(c, isa).backward(c.values.colors, c.upstream, *by_picture)
    return error, by_error, by_picture


def test_the_cases_have_what_they_are_for() -> None:
    levels = {name: {drawing.level_of(*f) for f in case(name).values.factors.tolist()} for name in CASES}
    for name in ("not of whole tiles", "of several tiles", "narrow"):
        assert levels[name] >= {0, 1, 2, 3}, name
    assert levels["all levels"] == set(range(drawing.MAX_LEVEL + 1))
    assert levels["thresholds"] == set(range(6))


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("name", CASES)
def test_values(name: str, isa: int) -> None:
    c = case(name)
    assert np.abs(native_picture(c, isa) - c.picture).max() < VALUE_TOLERANCE


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("name", CASES)
def test_gradients(name: str, isa: int) -> None:
    c = case(name)
    error, by_error, by_picture = native_gradients(c, isa)
    assert error == pytest.approx(c.error, rel=ERROR_TOLERANCE)
    for found, expected in zip((*by_error, *by_picture), (*c.by_error, *c.by_picture), strict=True):
        if found.size:
            assert np.abs(found - expected).max() < GRADIENT_TOLERANCE * np.abs(expected).max()


@pytest.mark.parametrize("name", CASES)
def test_the_same_on_every_instruction_set_and_for_every_number_of_threads(
    name: str, set_threads: Callable[[int], None]
) -> None:
    """Pixels are; gradients, which may use fused arithmetic, for every number of threads."""
    c = case(name)
    background = (0.2, 0.7, 0.4)
    pictures, pixels, gradients_of = [], [], {isa: [] for isa in ISAS}
    for threads in (1, 2, 5):
        set_threads(threads)
        for isa in ISAS:
            pictures.append(native_picture(c, isa))
            pixels.append(np.full((c.size[1], c.size[0], 3), 77, np.uint8))
            rasterised(c, isa).render_bytes(c.values.colors, pixels[-1], background)
            error, by_error, by_picture = native_gradients(c, isa)
            gradients_of[isa].append(b"".join(np.asarray(a).tobytes() for a in (error, *by_error, *by_picture)))
    assert all(np.array_equal(other, pictures[0]) for other in pictures)
    assert all(np.array_equal(other, pixels[0]) for other in pixels)
    assert all(len(set(found)) == 1 for found in gradients_of.values())
    shown = np.floor((pictures[0].transpose(1, 2, 0) + np.float32(background)).clip(0, 1) * 255 + 0.5)
    assert np.abs(shown - pixels[0]).max() <= 1  # the background is what the sum begins with


def test_narrow_gaussians_are_drawn_as_without_a_pyramid() -> None:
    c = case_of(scattered((83, 70), 60, 1.3, 0), (83, 70))
    plain = np.empty_like(c.upstream)
    native.Rasterization(c.values.means, c.values.factors, *c.size, CUTOFF).render(c.values.colors, plain)
    assert np.array_equal(native_picture(c, native.best_isa()), plain)


def test_a_pyramid_is_near_the_plain_sum() -> None:
    """At the narrow end of each level, in parts of the amplitude."""
    for level in range(1, 6):
        minor = drawing.NARROWEST * 2**level * 1.001
        for factor in ([minor, 0, minor], turned(5 * minor, minor)):
            c = case_of(single([[40.3, 30.7]], [factor], [[1, 1, 1]]), (80, 60))
            plain = np.empty_like(c.upstream)
            native.Rasterization(c.values.means, c.values.factors, *c.size, CUTOFF).render(c.values.colors, plain)
            assert np.abs(native_picture(c, 0) - plain).max() < 0.03  # worst seen 0.021


def needles(size: Size) -> Gaussians:
    """Of the largest slant that fits keep to, 2,048: they are at least 4,096 times as long as they are wide."""
    rng, n = np.random.default_rng(0), 12
    l3 = np.exp(rng.uniform(np.log(0.3), 0, n))
    l2 = rng.choice([-1, 1], n) * 2048 * l3
    l1 = np.abs(l2) * np.exp(rng.uniform(-1, 1, n))
    return single(rng.uniform(0.1, 0.9, (n, 2)) * size, np.stack([l1, l2, l3], 1), rng.uniform(-1, 1, (n, 3)))


def in_frame(factors: FloatArray, by_mean: FloatArray, by_factor: FloatArray) -> NDArray[np.float64]:
    """Gradients as the optimiser takes them: by moves of the mean, and of the factor, along the factor's columns."""
    l1, l2, l3 = factors.astype(np.float64).T
    (x, y), (a, b, c) = by_mean.astype(np.float64).T, by_factor.astype(np.float64).T
    return np.stack([l1 * x + l2 * y, l3 * y, l1 * a + l2 * b, l3 * b, l3 * c], 1)


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("size", [(83, 70), (200, 150)])
def test_needles_of_the_largest_slant(size: Size, isa: int) -> None:
    """In parts of each needle's own gradient; and, as the optimiser takes them, of the largest. There two numbers that
    are thousands of times as large cancel along the needle."""
    c = needle_case(size)
    assert np.abs(native_picture(c, isa) - c.picture).max() < 3e-5  # worst seen 6.5e-6
    for by, expected in zip(native_gradients(c, isa)[1:], (c.by_error, c.by_picture), strict=True):
        for found, true in zip(by, expected, strict=True):
            error = np.linalg.norm(found - true, axis=1) / np.linalg.norm(true, axis=1)
            assert error.max() < 4e-4  # worst seen 1.2e-4
        found, true = (in_frame(c.values.factors, *gradients[:2]) for gradients in (by, expected))
        assert (np.abs(found - true).max(0) < 0.02 * np.abs(true).max(0)).all()  # worst seen 0.008


@cache
def needle_case(size: Size) -> Case:
    return case_of(needles(size), size)
