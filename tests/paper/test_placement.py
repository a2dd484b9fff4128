"""Structure of a picture, the allocation of Gaussians to its regions, and where they start."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray

from sgmethod.paper import structure
from sgmethod.paper.placement import allocate, dynamic_ratio, place_by_structure
from sgmethod.paper.settings import STRUCTURE
from sgmethod.paper.structure import Structure
from sgmethod.scene import Gaussians
from tests.support.pictures import ODD, grey, photo

FloatArray = NDArray[np.float32]
KODAK = 768 * 512
PHOTO = photo() / np.float32(255)
STARTS = {
    "paper": STRUCTURE,
    "random": replace(STRUCTURE, structure_guided=False),
}


def start(image: FloatArray, n: int, name: str = "paper") -> Gaussians:
    return place_by_structure(image, n, STARTS[name], np.random.default_rng(0))


def analyse(image: FloatArray, regions: int = 16) -> Structure:
    return structure.analyse(image, regions, STRUCTURE)


def test_a_ramp_of_slope_one_has_gradient_one() -> None:
    ramp = grey(np.arange(20.0)[None, :] + np.zeros((10, 1))) / 19
    gradient = analyse(ramp).gradient
    assert np.allclose(gradient[:, 1:-1] * 19, 1, atol=1e-5)  # worst seen 2e-6
    assert np.allclose(analyse(ramp.transpose(1, 0, 2)).gradient[1:-1] * 19, 1, atol=1e-5)


def test_regions_partition_the_picture() -> None:
    found = analyse(PHOTO, 30)
    assert found.labels.shape == PHOTO.shape[:2]
    assert np.array_equal(np.unique(found.labels), np.arange(len(found.area)))
    assert np.array_equal(np.bincount(found.labels.ravel()), found.area)
    assert 15 <= len(found.area) <= 45


def test_complexity_is_the_variance_of_the_gradient_in_a_region() -> None:
    found = analyse(PHOTO, 30)
    assert len(found.complexity) == len(found.area)
    for region, complexity in enumerate(found.complexity):
        expected = found.gradient[found.labels == region].astype(np.float64).var()
        assert complexity == pytest.approx(expected, rel=1e-4, abs=1e-9)  # worst seen 5e-8


def test_few_gaussians_go_where_detail_is_and_very_many_everywhere() -> None:
    for n in (1, 800, 5000, STRUCTURE.ratio_start):
        assert dynamic_ratio(n, KODAK, STRUCTURE) == pytest.approx((6 / 9, 2 / 9, 1 / 9))
    threshold = int(STRUCTURE.threshold_factor * KODAK**STRUCTURE.threshold_exponent)
    for n in (threshold + 1, 2 * threshold, KODAK):
        assert dynamic_ratio(n, KODAK, STRUCTURE) == pytest.approx((1 / 3, 1 / 3, 1 / 3))
    settings = replace(STRUCTURE, ratio=(5.0, 3.0, 2.0))  # of any sum
    assert dynamic_ratio(1, KODAK, settings) == pytest.approx((0.5, 0.3, 0.2))


def test_the_ratio_passes_from_one_to_the_other() -> None:
    counts = np.linspace(STRUCTURE.ratio_start, 80_000, 50).astype(int)
    ratios = np.array([dynamic_ratio(n, KODAK, STRUCTURE) for n in counts])
    assert np.allclose(ratios.sum(1), 1)
    assert (np.diff(ratios[:, 0]) <= 0).all()
    assert (np.diff(ratios[:, 1:], axis=0) >= 0).all()
    threshold = STRUCTURE.threshold_factor * KODAK**STRUCTURE.threshold_exponent
    middle = int((STRUCTURE.ratio_start + threshold) / 2)
    s = 0.5**STRUCTURE.ratio_exponent
    expected = (1 - s) * 6 / 9 + s / 3
    assert dynamic_ratio(middle, KODAK, STRUCTURE)[0] == pytest.approx(expected, abs=1e-5)  # half a Gaussian's rounding


@pytest.mark.parametrize("pixels", [1, 2, 4096, 45_000])
def test_a_small_picture_has_a_ratio_too(pixels: int) -> None:
    """Its N_t lies below n_0; gamma is even, so a power of the negative base would be positive."""
    assert STRUCTURE.threshold_factor * pixels**STRUCTURE.threshold_exponent < STRUCTURE.ratio_start
    for n in (1, min(pixels, STRUCTURE.ratio_start), STRUCTURE.ratio_start):
        assert dynamic_ratio(n, pixels, STRUCTURE) == pytest.approx((6 / 9, 2 / 9, 1 / 9))
    assert dynamic_ratio(STRUCTURE.ratio_start + 1, pixels, STRUCTURE) == pytest.approx((1 / 3, 1 / 3, 1 / 3))


RATIOS = [(6 / 9, 2 / 9, 1 / 9), (1 / 3, 1 / 3, 1 / 3), (0.5, 0.3, 0.2)]


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("regions", [1, 2, 3, 4, 10, 333])
def test_allocation_sums_to_n_and_favours_complexity(regions: int, ratio: tuple[float, float, float]) -> None:
    complexity = np.random.default_rng(regions).random(regions).astype(np.float32)
    descending = np.argsort(-complexity)
    for n in (1, 2, 3, 4, 7, 10, 99, 100, 101, 1000, 12345):
        counts = allocate(complexity, np.full(regions, 7), n, ratio)
        assert counts.sum() == n
        assert (counts >= 0).all()
        assert (np.diff(counts[descending]) <= 0).all(), (n, counts[descending])


def test_allocation_follows_the_ratio() -> None:
    complexity, area = np.arange(9, dtype=np.float32)[::-1], np.full(9, 50)
    shared = partial(allocate, complexity, area)
    assert shared(900, RATIOS[0]).tolist() == [201] * 3 + [66] * 3 + [33] * 3
    assert shared(900, RATIOS[1]).tolist() == [100] * 9
    assert shared(4, RATIOS[0]).tolist() == [1, 1, 1, 1, 0, 0, 0, 0, 0]
    equal = np.zeros(4, np.float32)  # in a stable order
    assert allocate(equal, np.full(4, 9), 2, RATIOS[1]).tolist() == [1, 1, 0, 0]


def test_categories_are_thirds_of_the_picture_and_regions_share_by_area() -> None:
    complexity, area = np.array([1, 4, 3, 2], np.float32), np.array([30, 10, 20, 30])
    assert allocate(complexity, area, 90, RATIOS[0]).tolist() == [10, 20, 40, 20]
    assert allocate(complexity, area, 90, RATIOS[1]).tolist() == area.tolist()
    area = np.array([45, 9, 9, 27])
    assert allocate(complexity, area, 90, RATIOS[0]).tolist() == [10 + 10, 18, 18, 24 + 10]  # two are on a border


PICTURES = {"photograph": PHOTO, **ODD}


@pytest.mark.parametrize("kind", STARTS)
@pytest.mark.parametrize("name", PICTURES)
def test_every_start_is_sound(name: str, kind: str) -> None:
    image = PICTURES[name]
    height, width = image.shape[:2]
    for n in {min(n, height * width) for n in (1, 2, 3, 10, 100, 1000)}:
        found = start(image, n, kind)
        assert [array.shape for array in found.arrays] == [(n, 2), (n, 3), (n, 3)]
        assert all(array.dtype == np.float32 and np.isfinite(array).all() for array in found.arrays)
        assert ((found.means >= 0) & (found.means <= (width, height))).all()
        assert (found.factors[:, [0, 2]] > 0).all()
        assert ((found.colors >= 0) & (found.colors <= 1)).all()
        assert (found.factors[:, 0] == found.factors[:, 2]).all()
        assert not found.factors[:, 1].any()


def test_colours_are_those_of_the_picture_below() -> None:
    for kind in ("paper", "random"):
        found = start(PHOTO, 200, kind)
        columns, rows = np.floor(found.means).astype(int).T
        assert np.array_equal(found.colors, PHOTO[rows, columns])


def test_the_start_is_denser_in_the_more_complex_half() -> None:
    image = PHOTO.copy()
    image[:, :64] = 0.5
    for n in (60, 300):
        assert (start(image, n).means[:, 0] > 63).mean() > 0.65  # 0.7 to 0.82 seen; an even start has 0.5
    assert abs((start(image, 300, "random").means[:, 0] > 63).mean() - 0.5) < 0.1


def test_at_the_threshold_the_papers_start_is_even() -> None:
    """The ratio is 1:1:1 there, and Gaussians are uniform in each category."""
    settings = replace(STRUCTURE, ratio_start=10, threshold_factor=0.0)
    means = place_by_structure(PHOTO, 3000, settings, np.random.default_rng(0)).means
    counts = np.histogram2d(*means.T, bins=(8, 6), range=[[0, PHOTO.shape[1]], [0, PHOTO.shape[0]]])[0]
    assert counts.std() / counts.mean() < 1.5 / np.sqrt(counts.mean())  # as of random numbers, 1 in place of 1.5


def test_scales_cover_the_picture() -> None:
    """Discs of the starting scale have together about the picture's area."""
    for image in (PHOTO, ODD["grey"]):
        for kind in ("paper", "random"):
            l1, _, l3 = start(image, 60, kind).factors.T.astype(np.float64)
            covered = np.pi * (l1 * l3).sum() / (image.shape[0] * image.shape[1])
            assert 0.5 < covered < 2, covered  # 0.7 to 1.2 seen
