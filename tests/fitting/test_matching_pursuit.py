"""Matching pursuit: where a residual says that another Gaussian would pay, of which size, and in which order."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sgmethod.fitting.matching_pursuit import BLURS_PX, SCALE_OF_BLUR, candidates
from sgmethod.native import native
from tests.support.pictures import noise

FloatArray = NDArray[np.float32]
ALL_COARSER = len(BLURS_PX)  # sizes of the picture, at most


def found_in(
    residual: FloatArray, most: int, min_gain: float, suppression_levels: int = ALL_COARSER
) -> tuple[FloatArray, FloatArray]:
    """What is found in a residual [H, W, 3]."""
    planes = np.ascontiguousarray(residual.transpose(2, 0, 1))
    return candidates(lambda first, end: planes[:, first:end], residual.shape[:2], most, min_gain, suppression_levels)


def planted(
    scale: float, at: tuple[float, float], color: tuple[float, float, float], size: tuple[int, int]
) -> FloatArray:
    """The residual [H, W, 3] of one missing round Gaussian."""
    means, factors, colors = (np.array([v], np.float32) for v in (at, (scale, 0.0, scale), color))
    drawn = np.empty((3, *size[::-1]), np.float32)
    native.Rasterization(means, factors, *size, native.CUTOFF_V2).render(colors, drawn)
    return np.ascontiguousarray(drawn.transpose(1, 2, 0))


@pytest.mark.parametrize("blur", BLURS_PX[1:5])
def test_a_planted_gaussian_is_found(blur: float) -> None:
    scale = blur * SCALE_OF_BLUR
    means, factors = found_in(planted(scale, (80.5, 70.5), (0.3, -0.2, 0.1), (161, 140)), 1, 0.0)
    assert len(means) == len(factors) == 1
    assert means[0] == pytest.approx((80.5, 70.5), abs=0.1 + 0.1 * scale)
    assert factors[0] == pytest.approx((scale, 0, scale))


def test_the_best_come_first_and_no_more_than_asked() -> None:
    residual = planted(3.0, (30.5, 30.5), (0.3, 0.3, 0.3), (200, 120))
    residual += planted(3.0, (150.5, 80.5), (0.5, 0.5, 0.5), (200, 120))
    means, _ = found_in(residual, 2, 1.0)
    assert means[0] == pytest.approx((150.5, 80.5), abs=0.5)
    assert means[1] == pytest.approx((30.5, 30.5), abs=0.5)
    for most in (0, -3):
        assert len(found_in(residual, most, 0.0)[0]) == 0


def test_a_frame_promises_nothing_beyond_the_edge() -> None:
    """The sides of smaller pictures are odd: 113, 57, 29 and 15."""
    residual = planted(5.0, (88.5, 80.5), (0.3, 0.3, 0.3), (113, 170))
    residual[:, -1] = 0.5
    means, _ = found_in(residual, 1, 0.0)
    assert means[0] == pytest.approx((88.5, 80.5), abs=1)


def test_a_wide_error_hides_narrow_ones_only_where_it_is_to() -> None:
    size = (250, 250)
    narrow = [(x, y) for x in (60.5, 100.5, 140.5, 180.5) for y in (60.5, 100.5, 140.5, 180.5)]
    residual = planted(50.0, (125.0, 125.0), (0.04, 0.04, 0.04), size)
    for at in narrow:
        residual += planted(2.0, at, (-0.4, 0.2, 0.2), size)

    def dots(suppression_levels: int) -> int:
        means, factors = found_in(residual, 100, 0.1, suppression_levels)
        near = np.abs(means[:, None] - np.array(narrow)).max(axis=2) < 1.0
        return int((near & (factors[:, :1] < 5.0)).any(axis=0).sum())

    assert dots(ALL_COARSER) == 0
    assert dots(1) == dots(2) == len(narrow)


def test_none_gains_less_than_the_least() -> None:
    """The gain is the energy of the Gaussian that is missing, within a tenth: the blur is by a whole one."""
    residual = planted(3.0 * SCALE_OF_BLUR, (60.5, 50.5), (0.4, 0.4, 0.4), (121, 100))
    energy = float(np.square(residual).sum())
    assert len(found_in(residual, 10, 1.12 * energy)[0]) == 0
    assert len(found_in(residual, 10, 0.9 * energy)[0]) == 1
    assert len(found_in(np.zeros((40, 40, 3), np.float32), 10, 0.0)[0]) == 0


@pytest.mark.parametrize("size", [(1, 1), (1, 2), (2, 1), (3, 300), (300, 3), (17, 131), (257, 64)])
def test_odd_sizes(size: tuple[int, int]) -> None:
    means, _ = found_in(noise(*size) - 0.5, 50, 0.0)
    assert 1 <= len(means) <= 50
    assert (means > 0).all()
    assert (means < (size[1], size[0])).all()
    assert len(np.unique(means, axis=0)) == len(means)


@pytest.mark.parametrize("isa", range(native.best_isa() + 1))
@pytest.mark.parametrize("size", [(40, 1100), (7, 3), (1, 40)])
def test_gains_are_those_of_their_definition(isa: int, size: tuple[int, int]) -> None:
    """Narrower and wider than a blur, and than the columns that are blurred together."""
    planes = np.random.default_rng(1).normal(0, 0.1, (3, *size)).astype(np.float32)
    sigmas, scales = np.array([0.42, 0.75, 1.5], np.float32), np.array([2.0, 1.5, 5.0], np.float32)
    gain, chosen = np.empty(size, np.float32), np.empty(size, np.uint8)
    native.gains(planes[0], planes[1], planes[2], sigmas, scales, gain, chosen, isa)
    squares = [sum(blurred(plane, sigma) ** 2 for plane in planes) for sigma in sigmas]
    wanted = np.array(squares) * scales[:, None, None]
    assert gain == pytest.approx(wanted.max(axis=0), abs=2e-6 * wanted.max())  # worst seen 4e-7
    own = np.take_along_axis(wanted, chosen[None].astype(np.intp), axis=0)[0]
    assert own == pytest.approx(wanted.max(axis=0), abs=2e-6 * wanted.max())


def blurred(plane: FloatArray, sigma: float) -> NDArray[np.float64]:
    """A plane, mirrored at its edges, blurred by a Gaussian that ends at four sigma."""
    radius = round(4 * float(sigma))
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / float(sigma)) ** 2)
    values = plane.astype(np.float64)
    for axis in (0, 1):
        margins = [(radius, radius) if axis == other else (0, 0) for other in (0, 1)]
        padded = np.pad(values, margins, "reflect")
        values = np.apply_along_axis(np.convolve, axis, padded, weights / weights.sum(), "valid")
    return values
