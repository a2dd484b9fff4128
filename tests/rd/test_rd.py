"""Profile rd: what each kind of budget comes to, whatever the picture."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import sgmethod
from sgmethod import Budget, Encoded, decode
from sgmethod.bitstream import container
from sgmethod.bitstream.v2 import SMALLEST_FILE, StreamV2
from sgmethod.native import native
from sgmethod.rd.aim import PsnrAim
from sgmethod.settings.rd import RD, RdSettings
from tests.rd.short import short
from tests.support.pictures import ODD, grey, noise, photo
from tests.support.profiles import encode_with

FloatArray = NDArray[np.float32]
CROP = photo()[24:72, 40:104] / np.float32(255)  # a parrot's eye, 64 x 48
SHORT = short(240)
SHORTEST = short(40)


def encode(pixels: FloatArray, budget: Budget, settings: RdSettings = SHORT, **named: Any) -> Encoded:
    return encode_with(settings, pixels, budget, **named)


def quadrants(side: int) -> FloatArray:
    """Hard edges, strong colours: what a few bytes cannot hold."""
    y, x = np.indices((side, side)) * 4 // side
    return np.stack([(x + y) % 2, (x + y) % 2 * x / 3, (x + y) % 2 * y / 3], 2).astype(np.float32)


def stream(encoded: Encoded) -> StreamV2:
    found = container.parse(encoded.data)
    assert isinstance(found, StreamV2)
    return found


def assert_sound(encoded: Encoded, pixels: FloatArray) -> None:
    """A file that decodes, with numbers that are numbers."""
    gaussians = stream(encoded).gaussians()
    for values in (gaussians.means, gaussians.factors, gaussians.colors):
        assert np.isfinite(values).all()
    assert decode(encoded.data).shape == pixels.shape
    assert not math.isnan(encoded.stats.psnr)
    assert all(math.isfinite(point.psnr) for point in encoded.trace)


@pytest.mark.parametrize("max_bytes", [SMALLEST_FILE, 41, 100])
@pytest.mark.parametrize("picture", [lambda: quadrants(400), lambda: CROP, lambda: noise(30, 40)])
def test_a_few_bytes_are_never_exceeded(picture: Callable[[], FloatArray], max_bytes: int) -> None:
    """The coarsest steps alone would not do it on large pictures with strong colours."""
    encoded = encode(picture(), Budget("bytes", max_bytes), SHORTEST)
    assert_sound(encoded, picture())
    assert len(encoded.data) <= max_bytes


@pytest.mark.parametrize(("target_db", "beyond_db"), [(15.0, 0.5), (18.0, 0.2), (22.0, 0.2), (28.0, 0.2)])
def test_a_psnr_is_met_closely(target_db: float, beyond_db: float) -> None:
    encoded = encode(CROP, Budget("psnr", target_db))
    assert_sound(encoded, CROP)
    # Three Gaussians at 15 dB: one more is 0.3 dB. Files of 88 and 211 bytes at 18 and 22 dB: no single Gaussian is
    # left out to come nearer than the quantum comes. At 28 dB 0.05 with AVX-512; 0.14 with AVX2, where a file that is
    # nearer by 0.1 dB takes two bytes more, and so is not chosen.
    assert target_db <= encoded.stats.psnr <= target_db + beyond_db


def test_a_fit_stays_where_the_file_can_put_it() -> None:
    """Centres that drifted off were moved back by the file, and the quantum ran away: 10,388 bytes at 42.3 dB."""
    encoded = encode(photo("kodim05-crop"), Budget("psnr", 36), RD)
    assert 36 <= encoded.stats.psnr < 36.5
    assert len(encoded.data) < 5000


def test_more_bytes_than_anyone_needs_are_not_filled_with_gaussians() -> None:
    """With as many as pixels at the start, it was 16.5 dB."""
    assert encode(noise(32, 40), Budget("bytes", 10**12)).stats.psnr > 25


def test_a_given_number_holds_under_a_time_limit() -> None:
    pixels = np.ascontiguousarray(np.tile(CROP, (4, 4, 1)))
    assert encode(pixels, Budget("gaussians", 60), time_limit_s=0.3).stats.gaussians <= 60


def test_growth_goes_on_in_small_pictures() -> None:
    """Seen: 33 dB; 23 while scales as wide as the picture hid the places where something was missing."""
    assert encode(CROP, Budget("bytes", 3000)).stats.psnr > 30


def test_a_psnr_out_of_reach_gives_a_good_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise in 60 steps; with the rounds that a missed PSNR gets, 60 dB are reached."""
    settings = short(60, rounds=(0,))
    assert encode(noise(24, 32), Budget("psnr", 60), settings).stats.psnr >= 60
    monkeypatch.setattr(PsnrAim, "further_rounds", 0)
    encoded = encode(noise(24, 32), Budget("psnr", 60), settings)
    assert_sound(encoded, noise(24, 32))
    assert 15 < encoded.stats.psnr < 60


@pytest.mark.parametrize("n", [1, 3, 20, 90])
def test_gaussians_are_at_most_as_many_as_asked(n: int) -> None:
    encoded = encode(CROP, Budget("gaussians", n))
    assert_sound(encoded, CROP)
    assert n - max(n // 5, 1) <= encoded.stats.gaussians <= n  # one that is not worth its bits goes


@pytest.mark.parametrize("budget", [Budget("bytes", 4000), Budget("quality", 80), Budget("psnr", 45)])
def test_a_flat_image_costs_tens_of_bytes(budget: Budget) -> None:
    between = np.full((90, 120, 3), (0.2, 0.5, 0.8), np.float32)  # 0.5 lies between two levels
    encoded = encode(between, budget)
    assert_sound(encoded, between)
    assert len(encoded.data) < 50
    assert encoded.stats.psnr > 45
    exact = np.full((90, 120, 3), (51, 127, 204), np.uint8)
    encoded = encode(exact, budget)
    assert (encoded.stats.steps, encoded.trace[-1].phase) == (0, "done")
    assert (decode(encoded.data) == exact).all()


def test_a_grey_picture_has_no_chroma() -> None:
    pixels = grey(CROP[:, :, 1])
    encoded = encode(pixels, Budget("bytes", 500))
    assert_sound(encoded, pixels)
    assert stream(encoded).grey
    assert np.ptp(decode(encoded.data).astype(int), axis=2).max() == 0
    pixels[10:20, 10:20, 0] = np.clip(pixels[10:20, 10:20, 0] + 0.02, 0, 1)  # nearly grey
    for coloured in (CROP, pixels):
        assert not stream(encode(coloured, Budget("bytes", 500), SHORTEST)).grey


def line(side: int) -> FloatArray:
    """One pixel wide, at 45 degrees: needles, the longer the better."""
    return grey(np.eye(side))


def grating(side: int) -> FloatArray:
    """Stripes two pixels wide, at 45 degrees."""
    return grey(np.indices((side, side)).sum(0) // 2 % 2)


@pytest.mark.parametrize("picture", [lambda: line(32), lambda: line(96), lambda: grating(40)])
@pytest.mark.parametrize("budget", [Budget("bpp", 1), Budget("bpp", 16), Budget("quality", 100)])
def test_no_encode_clips(picture: Callable[[], FloatArray], budget: Budget) -> None:
    """A needle in a fine file would be drawn as something else."""
    before = native.rd_clipped_values()
    assert_sound(encode(picture(), budget), picture())
    assert native.rd_clipped_values() == before


@pytest.mark.parametrize("name", ODD)
@pytest.mark.parametrize(
    "budget",
    [Budget("bytes", 200), Budget("bpp", 8000), Budget("psnr", 25), Budget("gaussians", 1)],
    ids=lambda budget: budget.kind,
)
def test_odd_pictures(name: str, budget: Budget) -> None:
    pixels = ODD[name]
    encoded = encode(pixels, budget, SHORTEST)
    assert_sound(encoded, pixels)
    limit = budget.max_bytes(pixels.shape[1], pixels.shape[0])
    assert limit is None or len(encoded.data) <= limit


def test_a_picture_that_is_exact_takes_no_more_bytes_and_steps_where_more_are_allowed() -> None:
    step = np.full((96, 96, 3), 100, np.uint8)
    step[48:] = 101
    found = [sgmethod.encode(step, bpp=bpp, tune="psnr") for bpp in (0.1, 0.5, 3)]
    assert all(np.array_equal(decode(one.data), step) for one in found)
    assert max(len(one.data) for one in found) < 70  # seen: 40; once 372
    any_steps = sgmethod.encode(noise(96, 96), bpp=3, tune="psnr").stats.steps
    assert found[-1].stats.steps < 0.8 * any_steps  # seen: half


def test_an_exact_file_keeps_a_limit_just_below_its_size() -> None:
    """The fit was exact in some 2,000 bytes before its surplus was given up, and was written all the same."""
    columns = np.array([[255, 0, 0], [0, 0, 255]], np.uint8)[np.mgrid[:32, :40][1] % 2]
    for size in range(1600, 2101, 50):
        encoded = sgmethod.encode(columns, bytes=size, tune="psnr")
        assert len(encoded.data) <= size
        assert encoded.stats.psnr > 60


def test_a_file_made_smaller_stays_exact_for_the_eye_and_under_alpha() -> None:
    dots = np.full((60, 80, 4), 200, np.uint8)
    dots[..., 3] = 255
    dots[20, 30], dots[41, 7] = (255, 0, 0, 255), (0, 0, 0, 0)
    for pixels in (dots, dots[..., :3]):
        encoded = sgmethod.encode(np.ascontiguousarray(pixels), bpp=8)
        assert encoded.stats.psnr == math.inf
        assert len(encoded.data) < 400
