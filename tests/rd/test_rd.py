"""Profile rd: what each kind of budget comes to, and where growth puts Gaussians."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from sgmethod import Budget, BudgetError, Encoded, codec, decode, encode
from sgmethod.bitstream import container
from sgmethod.bitstream.v4 import StreamV4
from sgmethod.fitting.leads import CoarseError
from sgmethod.fitting.picture import Picture
from sgmethod.fitting.recorder import Clock, Recorder
from sgmethod.fitting.request import Request
from sgmethod.io.image import read_image
from sgmethod.io.levels import to_8_bit
from sgmethod.native import native
from sgmethod.native.reference import render
from sgmethod.profiles import EFFORTS, RD, hurried, with_size
from sgmethod.rd.fit import RdFit
from sgmethod.rd.growth import ALL_COARSER, BLURS_PX, SCALE_OF_BLUR, candidates
from sgmethod.rd.rate_control import SMALLEST_FILE, RateControl, quality_quantum
from sgmethod.rd.runs import Runs, place
from tests.harness.data import PHOTOGRAPHS
from tests.rd.clocks import SlowClock

CUTOFF = native.CUTOFF_V3

FloatArray = NDArray[np.float32]
STEPS = 240
PIXEL_S = 1e-6


@pytest.fixture(autouse=True)
def short_profile(monkeypatch: pytest.MonkeyPatch) -> None:
    """Encodes of a fraction of a second."""
    monkeypatch.setattr(codec, "PROFILES", {**codec.PROFILES, "rd": replace(RD, steps=STEPS, ladder=(128, 1024))})


@cache
def crop() -> FloatArray:
    """A parrot's eye, 64 x 48."""
    return np.ascontiguousarray(read_image((PHOTOGRAPHS / "kodim23-crop.png").read_bytes())[24:72, 40:104])


def noise(height: int, width: int) -> FloatArray:
    return np.random.default_rng(0).random((height, width, 3)).astype(np.float32)


def quadrants(side: int) -> FloatArray:
    """Hard edges, strong colours: what a few bytes cannot hold."""
    y, x = np.indices((side, side)) * 4 // side
    return np.stack([(x + y) % 2, (x + y) % 2 * x / 3, (x + y) % 2 * y / 3], 2).astype(np.float32)


def stream(encoded: Encoded) -> StreamV4:
    found = container.parse(encoded.data)
    assert isinstance(found, StreamV4)
    return found


def assert_sound(encoded: Encoded, pixels: FloatArray) -> None:
    """A file that decodes, with numbers that are numbers."""
    gaussians = stream(encoded).gaussians()
    for values in (gaussians.means, gaussians.factors, gaussians.colors):
        assert np.isfinite(values).all()
    assert decode(encoded.data).shape == pixels.shape
    assert not math.isnan(encoded.stats.psnr)
    assert all(math.isfinite(point.psnr) for point in encoded.trace)


@pytest.mark.parametrize("max_bytes", [120, 300, 700, 1500])
def test_a_size_is_kept_and_used(max_bytes: int) -> None:
    encoded = encode(crop(), Budget("bytes", max_bytes))
    assert_sound(encoded, crop())
    assert 0.97 * max_bytes <= len(encoded.data) <= max_bytes


@pytest.mark.parametrize("max_bytes", [SMALLEST_FILE, 30, 41, 64, 100])
@pytest.mark.parametrize("picture", [lambda: quadrants(400), crop, lambda: noise(30, 40)])
def test_a_few_bytes_are_never_exceeded(
    picture: Callable[[], FloatArray], max_bytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The coarsest steps alone would not do it on large pictures with strong colours."""
    monkeypatch.setattr(codec, "PROFILES", {**codec.PROFILES, "rd": replace(RD, steps=40)})
    encoded = encode(picture(), Budget("bytes", max_bytes))
    assert_sound(encoded, picture())
    assert len(encoded.data) <= max_bytes


def test_fewer_bytes_than_a_file_has() -> None:
    with pytest.raises(BudgetError, match="at least 18 bytes"):
        encode(crop(), Budget("bytes", SMALLEST_FILE - 1))


@pytest.mark.parametrize(("target_db", "beyond_db"), [(15.0, 0.5), (18.0, 0.1), (22.0, 0.1), (28.0, 0.1)])
def test_a_psnr_is_met_closely(target_db: float, beyond_db: float) -> None:
    encoded = encode(crop(), Budget("psnr", target_db))
    assert_sound(encoded, crop())
    assert target_db <= encoded.stats.psnr <= target_db + beyond_db  # three Gaussians at 15 dB: one more is 0.3 dB


@pytest.mark.parametrize(("name", "target_db", "seed"), [("kodim05", 19.0, 1), ("kodim23", 18.0, 3)])
def test_a_psnr_is_met_with_few_gaussians(name: str, target_db: float, seed: int) -> None:
    """Where the quantum alone ends 0.16 and 0.12 dB above."""
    pixels = read_image((PHOTOGRAPHS / f"{name}-crop.png").read_bytes())
    encoded = encode(pixels, Budget("psnr", target_db), seed=seed)
    assert encoded.stats.gaussians < 30
    assert target_db <= encoded.stats.psnr <= target_db + 0.1


def test_a_fit_stays_where_the_file_can_put_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Centres that drifted off were moved back by the file, and the quantum ran away: 10,388 bytes at 42.3 dB."""
    monkeypatch.setattr(codec, "PROFILES", {**codec.PROFILES, "rd": RD})
    pixels = read_image((PHOTOGRAPHS / "kodim05-crop.png").read_bytes())
    encoded = encode(pixels, Budget("psnr", 36), seed=1)
    assert 36 <= encoded.stats.psnr < 36.5
    assert len(encoded.data) < 5000


def test_more_bytes_than_anyone_needs_are_not_filled_with_gaussians() -> None:
    """As many as pixels at the start: 16.5 dB."""
    assert encode(noise(48, 64), Budget("bytes", 10**12)).stats.psnr > 25


def test_a_given_number_and_quality_hold_under_a_time_limit() -> None:
    pixels = np.ascontiguousarray(np.tile(crop(), (4, 4, 1)))
    assert encode(pixels, Budget("gaussians", 60), time_limit_s=0.3).stats.gaussians <= 60
    coded = stream(encode(pixels, Budget("quality", 25), time_limit_s=0.3))
    assert coded.quantum == pytest.approx(quality_quantum(25), rel=1 / 256)


def test_growth_goes_on_in_small_pictures() -> None:
    """Seen: 33 dB; 23 while scales as wide as the picture hid the places where something was missing."""
    assert encode(crop(), Budget("quality", 85)).stats.psnr > 30


def test_a_psnr_out_of_reach_gives_a_good_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise in 60 steps; in 250 and a round 60 dB are reached, with a Gaussian for every other pixel."""
    monkeypatch.setattr(codec, "PROFILES", {**codec.PROFILES, "rd": replace(RD, steps=60)})
    encoded = encode(noise(24, 32), Budget("psnr", 60), effort=4)
    assert_sound(encoded, noise(24, 32))
    assert 15 < encoded.stats.psnr < 60


def test_quality_is_monotone_in_size_and_error() -> None:
    found = [encode(crop(), Budget("quality", quality)) for quality in (5, 25, 45, 65, 85)]
    for encoded in found:
        assert_sound(encoded, crop())
    sizes, decibels = [len(e.data) for e in found], [e.stats.psnr for e in found]
    assert sizes == sorted(sizes)
    assert decibels == sorted(decibels)
    assert decibels[-1] > decibels[0] + 10


def test_quality_is_a_quantum() -> None:
    """16 points halve it, and it is not steered."""
    assert quality_quantum(0) == 3.2
    assert quality_quantum(48) == pytest.approx(quality_quantum(32) / 2)
    coded = stream(encode(crop(), Budget("quality", 40)))
    assert coded.quantum == pytest.approx(quality_quantum(40), rel=1 / 256)


@pytest.mark.parametrize("n", [1, 3, 20, 90])
def test_gaussians_are_at_most_as_many_as_asked(n: int) -> None:
    encoded = encode(crop(), Budget("gaussians", n))
    assert_sound(encoded, crop())
    assert n - max(n // 5, 1) <= encoded.stats.gaussians <= n  # one that is not worth its bits goes


@pytest.mark.parametrize("budget", [Budget("bytes", 4000), Budget("quality", 80), Budget("psnr", 45)])
def test_a_flat_image_costs_tens_of_bytes(budget: Budget) -> None:
    pixels = np.full((90, 120, 3), (0.2, 0.5, 0.8), np.float32)  # 0.5 lies between two levels
    encoded = encode(pixels, budget)
    assert_sound(encoded, pixels)
    assert len(encoded.data) < 50
    assert encoded.stats.psnr > 45


@pytest.mark.parametrize("budget", [Budget("bytes", 4000), Budget("quality", 80), Budget("psnr", 45)])
def test_a_picture_of_one_colour_is_not_fitted(budget: Budget) -> None:
    pixels = np.full((90, 120, 3), (51, 127, 204), np.uint8)
    encoded = encode(pixels, budget)
    assert encoded.stats.steps == 0
    assert encoded.trace[-1].phase == "done"
    assert (decode(encoded.data) == pixels).all()


def test_a_grey_picture_has_no_chroma() -> None:
    grey = np.ascontiguousarray(np.repeat(crop()[:, :, 1:2], 3, 2))
    encoded = encode(grey, Budget("bytes", 500))
    assert_sound(encoded, grey)
    assert stream(encoded).grey
    assert np.ptp(decode(encoded.data).astype(int), axis=2).max() == 0
    assert not stream(encode(crop(), Budget("bytes", 500))).grey


def test_nearly_grey_is_not_grey() -> None:
    nearly = np.repeat(crop()[:, :, 1:2], 3, 2)
    nearly[10:20, 10:20, 0] = np.clip(nearly[10:20, 10:20, 0] + 0.02, 0, 1)
    assert not stream(encode(np.ascontiguousarray(nearly), Budget("bytes", 500))).grey


def line(side: int) -> FloatArray:
    """One pixel wide, at 45 degrees: needles, the longer the better."""
    return np.repeat(np.eye(side, dtype=np.float32)[:, :, None], 3, 2)


def grating(side: int) -> FloatArray:
    """Stripes two pixels wide, at 45 degrees."""
    y, x = np.indices((side, side))
    return np.repeat(((x + y) // 2 % 2).astype(np.float32)[:, :, None], 3, 2)


@pytest.mark.parametrize("picture", [lambda: line(32), lambda: line(96), lambda: grating(40)])
@pytest.mark.parametrize("budget", [Budget("bpp", 1), Budget("bpp", 4), Budget("bpp", 16), Budget("quality", 100)])
def test_no_encode_clips(picture: Callable[[], FloatArray], budget: Budget) -> None:
    """A needle in a fine file would be drawn as something else."""
    before = native.rd_clipped_values()
    assert_sound(encode(picture(), budget), picture())
    assert native.rd_clipped_values() == before


ODD: dict[str, Callable[[], FloatArray]] = {
    "noise": lambda: noise(40, 50),
    "1x1": lambda: np.full((1, 1, 3), (0.9, 0.1, 0.4), np.float32),
    "2x1": lambda: np.array([[[0, 0, 0], [1, 1, 1]]], np.float32),
    "1x4096": lambda: noise(4096, 1),
    "4096x1": lambda: noise(1, 4096),
    "black": lambda: np.zeros((9, 8, 3), np.float32),
    "white": lambda: np.ones((9, 8, 3), np.float32),
    "one bright pixel": lambda: np.pad(np.ones((1, 1, 3), np.float32), ((20, 20), (20, 20), (0, 0))),
}


@pytest.mark.parametrize("name", ODD)
@pytest.mark.parametrize(
    "budget",
    [Budget("bytes", 200), Budget("bpp", 8000), Budget("psnr", 25), Budget("quality", 100), Budget("gaussians", 1)],
    ids=lambda budget: budget.kind,
)
def test_odd_pictures(name: str, budget: Budget, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(codec, "PROFILES", {**codec.PROFILES, "rd": replace(RD, steps=40)})
    pixels = ODD[name]()
    encoded = encode(pixels, budget)
    assert_sound(encoded, pixels)
    limit = budget.max_bytes(pixels.shape[1], pixels.shape[0])
    assert limit is None or len(encoded.data) <= limit


@pytest.mark.parametrize("budget", [Budget("bytes", 400), Budget("psnr", 24), Budget("quality", 50)])
def test_a_time_limit_shortens_the_schedule(budget: Budget, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(codec, "Clock", SlowClock)
    encoded = encode(crop(), budget, time_limit_s=2.0)
    assert_sound(encoded, crop())
    assert 40 < encoded.stats.steps < 120  # of STEPS
    assert encoded.stats.seconds < 2.1
    if budget.kind == "bytes":
        assert 0.9 * 400 <= len(encoded.data) <= 400
    assert encode(crop(), budget, time_limit_s=1e-9).stats.steps < 3

    steps: list[int] = []
    stopped = encode(
        crop(), budget, on_progress=lambda point: steps.append(point.step), stop=lambda: max(steps, default=0) >= 40
    )
    assert_sound(stopped, crop())
    assert 42 < stopped.stats.steps < 70
    if budget.kind == "bytes":
        assert 0.8 * 400 <= len(stopped.data) <= 400


def found_in(
    residual: FloatArray, most: int, least_gain: float, hidden_by: int = ALL_COARSER
) -> tuple[FloatArray, FloatArray]:
    """What growth finds in a residual [H, W, 3]."""
    planes = np.ascontiguousarray(residual.transpose(2, 0, 1))
    return candidates(lambda first, end: planes[:, first:end], residual.shape[:2], most, least_gain, hidden_by)


def planted(
    scale: float, at: tuple[float, float], color: tuple[float, float, float], size: tuple[int, int]
) -> FloatArray:
    """The residual [H, W, 3] of one missing round Gaussian."""
    means, factors, colors = (torch.tensor([v]) for v in (at, (scale, 0.0, scale), color))
    return np.ascontiguousarray(render(means, factors, colors, size, CUTOFF).numpy().transpose(1, 2, 0))


@pytest.mark.parametrize("blur", BLURS_PX[1:5])
def test_growth_finds_a_planted_gaussian(blur: float) -> None:
    scale = blur * SCALE_OF_BLUR
    means, factors = found_in(planted(scale, (80.5, 70.5), (0.3, -0.2, 0.1), (161, 140)), 1, 0.0)
    assert len(means) == len(factors) == 1
    assert means[0] == pytest.approx((80.5, 70.5), abs=0.1 + 0.1 * scale)
    assert factors[0] == pytest.approx((scale, 0, scale))


def test_growth_takes_the_best_first_and_no_more_than_asked() -> None:
    residual = planted(3.0, (30.5, 30.5), (0.3, 0.3, 0.3), (200, 120))
    residual += planted(3.0, (150.5, 80.5), (0.5, 0.5, 0.5), (200, 120))
    means, _ = found_in(residual, 2, 1.0)
    assert means[0] == pytest.approx((150.5, 80.5), abs=0.5)
    assert means[1] == pytest.approx((30.5, 30.5), abs=0.5)
    for most in (0, -3):
        assert len(found_in(residual, most, 0.0)[0]) == 0


def test_a_wide_error_hides_narrow_ones_from_growth_only_where_it_is_to() -> None:
    size = (250, 250)
    narrow = [(x, y) for x in (60.5, 100.5, 140.5, 180.5) for y in (60.5, 100.5, 140.5, 180.5)]
    residual = planted(50.0, (125.0, 125.0), (0.04, 0.04, 0.04), size)
    for at in narrow:
        residual += planted(2.0, at, (-0.4, 0.2, 0.2), size)

    def dots(hidden_by: int) -> int:
        means, factors = found_in(residual, 100, 0.1, hidden_by)
        near = np.abs(means[:, None] - np.array(narrow)).max(axis=2) < 1.0
        return int((near & (factors[:, :1] < 5.0)).any(axis=0).sum())

    assert dots(ALL_COARSER) == 0
    assert dots(1) == dots(2) == len(narrow)


def test_growth_respects_the_least_gain() -> None:
    """The gain is the energy of the Gaussian that is missing, within a tenth: the blur is by a whole one."""
    residual = planted(3.0 * SCALE_OF_BLUR, (60.5, 50.5), (0.4, 0.4, 0.4), (121, 100))
    energy = float(np.square(residual).sum())
    assert len(found_in(residual, 10, 1.12 * energy)[0]) == 0
    assert len(found_in(residual, 10, 0.9 * energy)[0]) == 1
    assert len(found_in(np.zeros((40, 40, 3), np.float32), 10, 0.0)[0]) == 0


@pytest.mark.parametrize("size", [(1, 1), (1, 2), (2, 1), (3, 300), (300, 3), (17, 131), (257, 64)])
def test_growth_on_odd_sizes(size: tuple[int, int]) -> None:
    means, _ = found_in(noise(*size) - 0.5, 50, 0.0)
    assert 1 <= len(means) <= 50
    assert (means > 0).all()
    assert (means < (size[1], size[0])).all()
    assert len(np.unique(means, axis=0)) == len(means)


def test_previews_are_files_that_come_nearer() -> None:
    files: list[bytes] = []
    encode(crop(), Budget("bytes", 2000), on_preview=files.append)
    errors = [np.square(decode(file).astype(float) - to_8_bit(crop())).mean() for file in files]
    assert len(files) > 5
    assert errors[0] > 1.5 * errors[-1]


def hurried_fit(seconds: float, monkeypatch: pytest.MonkeyPatch, any_s: float = 0.0) -> RdFit:
    """Of 160 x 128 pixels, on a machine whose gradients take PIXEL_S for each pixel, and any_s for any picture."""

    def gradient_s(_: RdFit, picture: Picture) -> float:
        return any_s + PIXEL_S * picture.height * picture.width

    monkeypatch.setattr(RdFit, "_gradient_s", gradient_s)
    fit = RdFit(to_8_bit(noise(128, 160)), RateControl(RD, 128 * 160, 0.1, max_bytes=2000), 0, Clock())
    with torch.no_grad():
        fit.hurry(seconds)
    return fit


def test_a_short_time_limit_is_for_a_smaller_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    short, unhurried = (hurried_fit(seconds, monkeypatch) for seconds in (0.0, math.inf))
    assert (short.settings, unhurried.settings) == (replace(RD, **EFFORTS[1], most=RD.most_hurried), RD)
    assert short.control.settings == short.settings
    assert (short.pyramid.finest.width, unhurried.pyramid.finest.width) == (20, 160)
    assert short.pyramid.at(1.0, RD.times, 1000) is short.pyramid.finest
    with torch.no_grad():
        before = len(short.p.means)
        short._grow(before + 10, RD.times.halved_until)
    added = short.p.means  # found in the small picture, but in pixels of the whole
    assert len(added) == before + 10
    assert added[:, 0].max() > 80
    assert added[:, 1].max() > 64
    assert short.p.factors[:, 0].min() > 8 * 0.3


def test_a_smaller_picture_is_fitted_only_as_far_as_it_saves_time(monkeypatch: pytest.MonkeyPatch) -> None:
    pixels = 128 * 160
    steps = hurried_fit(0.0, monkeypatch).control.steps()
    for in_time, halvings in ((1.1, 0), (0.3, 1), (0.1, 2), (0.01, 3)):
        fit = hurried_fit(in_time * steps * pixels * PIXEL_S, monkeypatch)
        assert fit.pyramid.finest is fit.pyramid.levels[halvings]
    for part, halvings in ((1.0, 0), (0.1, 2)):  # of what all pixels take, for any picture
        fit = hurried_fit(0.0, monkeypatch, part * pixels * PIXEL_S)
        assert fit.pyramid.finest is fit.pyramid.levels[halvings]


def test_no_grain_is_sought_where_a_smaller_picture_is_fitted() -> None:
    control = RateControl(replace(RD, tune="visual"), 64 * 48, 0.1, max_bytes=2000)
    for halvings in (0, 1):
        fit = RdFit(to_8_bit(crop()), control, 0, Clock())
        fit.pyramid.finest = fit.pyramid.levels[halvings]
        with torch.no_grad():
            fit.step(1.0, 0.9)
        assert isinstance(fit.picture.lead, CoarseError)
        assert (fit.picture.lead.grain is None) == (halvings > 0)


def test_a_fit_that_is_late_takes_some_steps_all_the_same() -> None:
    """Where making it took long, as that of a large picture does."""
    steps = []
    for made_s in (0.0, 6.0):
        recorder = Recorder(SlowClock(limit_s=1e-9), None)
        request = Request(to_8_bit(crop()), Budget("bytes", 400), "rd", "psnr", 5, 0, recorder)
        with torch.no_grad():
            fit = place(request, RateControl.of(request, RD), recorder.preview)
            fit.made_s = made_s
            runs = Runs(fit, request, 1000)
            runs.first()
        steps.append(runs.steps)
    assert steps[0] < 3
    assert 20 < steps[1] < 150


def test_the_trace_shows_what_would_be_decoded() -> None:
    """At a coarse quantum rounding costs decibels, which the unrounded Gaussians do not show."""
    pixels = to_8_bit(crop())
    fit = RdFit(pixels, RateControl(RD, 64 * 48, 1.0), 0, Clock())
    with torch.no_grad():
        for _ in range(50):
            fit.step(1.0, 0.0)
        fit.coder = fit.coder.with_quantum(4.0)
        shown = fit.decoded_mse()
    decoded = decode(container.serialise(fit.coder.stream(fit.p)))
    wanted = float(np.square((decoded - pixels.astype(np.float64)) / 255).mean())
    assert shown == pytest.approx(wanted, rel=0.01)  # but for 8 bits and what is clamped
    assert shown > 1.03 * fit.picture.error(fit.p)


def test_the_size_grows_with_the_gaussians() -> None:
    fit = RdFit(to_8_bit(crop()), RateControl(RD, 64 * 48, 0.1, max_bytes=2000), 0, Clock())
    with torch.no_grad():
        fit.step(1.0, RD.times.growth_at[0])
    before = fit.size / len(fit.p.means)
    with torch.no_grad():
        fit._grow(10**6, RD.times.growth_at[1])
    assert fit.size / len(fit.p.means) == pytest.approx(before, rel=0.05)


@pytest.mark.parametrize("pixels", [400_000, 8_000_000])
def test_a_time_limit_too_short_for_an_effort_takes_a_lower_one(pixels: int) -> None:
    one, two, three, five = (with_size(replace(RD, **EFFORTS[effort]), pixels) for effort in (1, 2, 3, 5))
    assert [hurried(five, pixels, steps) for steps in (math.inf, five.steps, five.steps - 1)] == [five, five, three]
    assert [hurried(five, pixels, steps) for steps in (three.steps - 1, two.steps - 1)] == [two, one]
    assert hurried(two, pixels, three.steps) == two
    with_few = replace(one, most=RD.most_hurried)
    assert [hurried(fit, pixels, one.steps - 1) for fit in (five, one)] == [with_few, with_few]


def test_large_pictures_are_spared_steps() -> None:
    small, *others, large = (with_size(RD, pixels) for pixels in (400_000, 2_000_000, 4_000_000, 8_000_000))
    assert small == RD
    assert large == with_size(RD, 50_000_000)
    found = [(one.steps, -one.times.halved_until) for one in (small, *others, large)]
    assert sorted(found, reverse=True) == found
    assert len(set(found)) == 4
    quick = replace(RD, **EFFORTS[1])
    assert with_size(quick, 8_000_000).times == quick.times  # which see small pictures for longer as it is
