"""What an encode aims at unless asked for something else: a quality, in a limited size, by an effort that suits it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from skimage import data

import sgmethod
from sgmethod.budget import DEFAULT_BUDGET, Budget
from sgmethod.encode_arguments import EncodeArguments
from sgmethod.profiles import PROFILE_NAMES
from tests.support.pictures import photo
from tests.support.profiles import OTHER

FACE = np.ascontiguousarray(data.astronaut()[40:280, 160:400])
DISC = np.where(np.hypot(*(np.mgrid[:240, :240] - 120)) < 90, 255, 0).astype(np.uint8)
NOISE = np.random.default_rng(0).integers(0, 256, (96, 128, 3), np.uint8)


def limit_of(picture: NDArray[np.uint8]) -> int:
    """The bytes that a file may have by default."""
    height, width = picture.shape[:2]
    return DEFAULT_BUDGET.max_bytes(width, height) or 0


def asked(width: int, height: int, profile: str = "rd", *, has_alpha: bool = False) -> EncodeArguments:
    """The arguments of an encode without any."""
    return EncodeArguments.checked(DEFAULT_BUDGET, profile, None, None).for_size(width, height, has_alpha=has_alpha)


@pytest.mark.parametrize("picture", [FACE, np.dstack([FACE, DISC])], ids=["opaque", "alpha"])
def test_the_quality_is_met_within_a_point(picture: NDArray[np.uint8]) -> None:
    stats = sgmethod.encode(picture, effort=2).stats
    assert DEFAULT_BUDGET.value - 1 < stats.ssimulacra2 < DEFAULT_BUDGET.value + 2
    assert stats.bytes < limit_of(picture)
    assert stats.warnings == []


@pytest.mark.parametrize("alpha", [False, True], ids=["opaque", "alpha"])
def test_the_limit_is_used_where_the_quality_takes_more(alpha: bool) -> None:
    """Which is no reason for a warning."""
    detail = photo("kodim05-crop")
    picture = np.dstack([detail, 192 + detail[..., 1] // 4]) if alpha else detail
    stats = sgmethod.encode(picture, effort=2).stats
    assert stats.ssimulacra2 < DEFAULT_BUDGET.value - 1
    assert 0.9 * limit_of(picture) < stats.bytes <= limit_of(picture)
    assert stats.warnings == []


@pytest.mark.parametrize("picture", [NOISE, np.dstack([NOISE, NOISE[..., 0]])], ids=["opaque", "alpha"])
def test_noise_stays_within_the_limit(picture: NDArray[np.uint8]) -> None:
    assert sgmethod.encode(picture, effort=1).stats.bytes <= limit_of(picture)


def test_a_plain_picture_is_no_reason_for_a_warning() -> None:
    """It has no Gaussians, and none would make it look better."""
    assert sgmethod.encode(np.full((32, 32, 3), 77, np.uint8)).stats.warnings == []


@pytest.mark.parametrize(
    ("size", "profile", "has_alpha"),
    [((500, 7), "rd", False), ((7, 500), "rd", True), ((64, 48), OTHER, False), ((640, 480), OTHER, False)],
)
def test_where_no_quality_can_be_aimed_at_the_limit_is_the_budget(
    size: tuple[int, int], profile: str, has_alpha: bool
) -> None:
    """Pictures too small for SSIMULACRA 2, and the profile that is always tuned for PSNR."""
    assert asked(*size, profile, has_alpha=has_alpha).budget == Budget("bytes", DEFAULT_BUDGET.max_bytes(*size) or 0)


@pytest.mark.parametrize("has_alpha", [False, True])
@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_the_smallest_pictures_get_the_smallest_file(profile: str, has_alpha: bool) -> None:
    for size in ((1, 1), (2, 3), (8, 8)):
        arguments = asked(*size, profile, has_alpha=has_alpha)
        assert arguments.budget.kind == "bytes"
        arguments.check_size(*size)


def test_a_row_of_pixels_uses_its_limit() -> None:
    row = FACE[:7]
    stats = sgmethod.encode(row, effort=1).stats
    assert stats.ssimulacra2 is None
    assert 0.9 * limit_of(row) < stats.bytes <= limit_of(row)


def test_large_pictures_take_less_effort() -> None:
    """Unless an effort is asked for; the other profile has none."""
    sizes = {(1, 1): 5, (2000, 1000): 5, (2000, 1001): 3, (3000, 2000): 3, (3000, 2001): 2, (8000, 6000): 2}
    assert {size: asked(*size).effort for size in sizes} == sizes
    assert {asked(*size, OTHER).effort for size in sizes} == {5}
    chosen = EncodeArguments.checked(DEFAULT_BUDGET, "rd", None, 7)
    assert chosen.for_size(8000, 6000, has_alpha=False).effort == 7
