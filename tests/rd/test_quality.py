"""A budget by quality: SSIMULACRA 2, as the figures of the encode have it."""

from __future__ import annotations

from unittest.mock import Mock

import numpy as np
import pytest
from skimage import data

import sgmethod
from sgmethod import Budget, BudgetError
from sgmethod.backend.protocol import NO_LIMIT
from sgmethod.budget import QUALITIES
from sgmethod.metrics import ssimulacra2
from sgmethod.rd.aim import Aim, PsnrAim, QualityAim
from sgmethod.rd.rate_control import ssimulacra2_db
from sgmethod.settings.rd import RD

PHOTO = np.ascontiguousarray(data.astronaut()[40:200, 160:320])
# In a file of 400 bytes for PHOTO, chance moves a score by two points from one quantum to the next.
LARGER = np.ascontiguousarray(data.astronaut()[40:360, 100:420])


@pytest.fixture(scope="module")
def found() -> list[sgmethod.Encoded]:
    return [sgmethod.encode(LARGER, quality=quality, effort=2) for quality in (40, 60, 75)]


def test_qualities_are_met_within_a_point(found: list[sgmethod.Encoded]) -> None:
    for asked, encoded in zip((40, 60, 75), found, strict=True):
        measured = encoded.stats.ssimulacra2
        assert measured == ssimulacra2(sgmethod.decode(encoded.data), LARGER)
        assert asked - 1 < measured < asked + 1.5  # 0.0 to 0.4 above with each instruction set
        assert (encoded.stats.quality_missed, encoded.stats.warnings) == (max(asked - measured, 0), [])
    assert found[0].stats.bytes < found[1].stats.bytes < found[2].stats.bytes


def test_a_file_by_quality_has_no_texture(found: list[sgmethod.Encoded]) -> None:
    without = [sgmethod.decode(encoded.data, view=sgmethod.View(texture=False)) for encoded in found]
    assert all(np.array_equal(sgmethod.decode(one.data), plain) for one, plain in zip(found, without, strict=True))


def test_a_quality_of_grain_is_met() -> None:
    """Grain is hidden from the fit at first. A further round must see it, at a finer quantum, and not settle for less:
    with any of the three left out 57.9 to 58.8 is reached, with all of them 59.7."""
    grain = np.random.default_rng(1).normal(0, 12, PHOTO.shape[:2])[..., None]
    stats = sgmethod.encode(np.clip(PHOTO + grain, 0, 255).astype(np.uint8), quality=60, effort=4).stats
    assert (stats.ssimulacra2 > 59, stats.warnings) == (True, [])


def test_a_quality_out_of_reach_is_a_warning() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (24, 32, 3), np.uint8)
    stats = sgmethod.encode(noise, quality=99.9, effort=1, time_limit_s=0.2).stats
    assert stats.quality_missed == pytest.approx(99.9 - stats.ssimulacra2)
    assert stats.warnings[0].startswith("the requested quality is missed by")


def test_the_quality_of_a_picture_with_alpha() -> None:
    y, x = np.mgrid[:64, :64]
    alpha = np.where(np.hypot(x - 32, y - 32) < 26, 255, 0).astype(np.uint8)
    stats = sgmethod.encode(np.dstack([PHOTO[:64, :64], alpha]), quality=50, effort=1).stats
    assert stats.ssimulacra2 > 45


@pytest.mark.parametrize("tune", ["psnr", "visual"])
def test_both_tunings_aim_at_quality(tune: str) -> None:
    assert 49 < sgmethod.encode(PHOTO, quality=50, tune=tune, effort=2).stats.ssimulacra2 < 56


def test_names_stand_for_qualities() -> None:
    assert {name: Budget("quality", name).value for name in QUALITIES} == {"preview": 40, "web": 60, "archive": 80}
    with pytest.raises(BudgetError, match="sides below 8 pixels"):
        sgmethod.encode(PHOTO[:7], quality=60)


@pytest.mark.parametrize(
    ("tries", "finer", "coarser"),
    [
        ([(0.0486, 5.686), (0.0776, 5.393), (0.3643, 2.224)], 0.0776, 0.3643),
        ([(0.0776, 5.393), (0.3643, 2.224), (0.0486, 5.686)], 0.0776, 0.3643),
        ([(0.3643, 2.224), (0.2, 3.5), (0.05, 8.0)], 0.05, 0.2),
        ([(0.05, 8.0), (0.1, 6.0)], 0.1, 1.0),
        ([(0.3, 2.0), (0.2, 3.0)], 0.05, 0.2),
    ],
)
@pytest.mark.parametrize("aim", [QualityAim.from_score(60, (2400, 1800), RD.effort), PsnrAim.from_psnr(3.98, 1)])
def test_a_search_goes_on_between_tries_above_and_below(
    aim: Aim, tries: list[tuple[float, float]], finer: float, coarser: float
) -> None:
    """In dB, with the aim at 3.98: the line through the two nearest ended at the third, and the file had 71 of 60."""
    tried = [Mock(stream=Mock(quantum=quantum), size=900, ssimulacra2_db=db, psnr=db) for quantum, db in tries]
    found = aim.next_quantum(tried, NO_LIMIT, 10)
    assert found is not None
    assert finer < found < coarser
    close = [Mock(stream=Mock(quantum=0.1), size=900, ssimulacra2_db=4.0, psnr=4.0)]
    assert aim.next_quantum([*tried, *close], NO_LIMIT, 10) is None


def test_decibels_of_ssimulacra2() -> None:
    assert [round(ssimulacra2_db(score), 1) for score in (0, 70, 90, 99)] == [0, 5.2, 10, 20]
