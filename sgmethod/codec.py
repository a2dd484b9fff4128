"""The pipeline in the order in which it runs: image -> structure -> Gaussians -> fit -> quantise -> bitstream."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from sgmethod import bitstream
from sgmethod.bitstream import Stream
from sgmethod.budget import Budget
from sgmethod.decode import decode
from sgmethod.errors import BudgetError, ImageError
from sgmethod.fit import Clock, Picture, Recorder, fit
from sgmethod.metrics import ms_ssim, psnr
from sgmethod.placement import place
from sgmethod.profiles import DEFAULT_PROFILE, PROFILES, Settings
from sgmethod.quantise.paper import Job, bits_per_gaussian, tune
from sgmethod.trace import Progress, TracePoint

FIT_SHARE = 0.6  # of a time limit; the rest is for tuning and for measuring the result
RESERVE_S = 0.1  # plus RESERVE_S_PER_MEGAPIXEL, kept back for writing and measuring the file
RESERVE_S_PER_MEGAPIXEL = 0.4
PSNR_ATTEMPTS = 4
PSNR_PER_DOUBLING_DB = 1.7  # of the number of Gaussians; where a search for a PSNR starts from


@dataclass(frozen=True)
class Stats:
    """What an encode came to. psnr and ms_ssim are of the decoded file; ms_ssim is None for small pictures."""

    bytes: int
    bpp: float
    psnr: float
    ms_ssim: float | None
    gaussians: int
    steps: int
    seconds: float
    width: int
    height: int
    profile: str

    def to_dict(self) -> dict[str, object]:
        """Plain JSON types; a lossless result has psnr None."""
        return {**asdict(self), "psnr": self.psnr if math.isfinite(self.psnr) else None}


@dataclass(frozen=True)
class Encoded:
    """An .sg file with its figures and the trace of how it came about."""

    data: bytes
    stats: Stats
    trace: list[TracePoint]


def encode(
    pixels: NDArray[np.float32],
    budget: Budget,
    profile: str = DEFAULT_PROFILE,
    *,
    seed: int = 0,
    time_limit_s: float | None = None,
    on_progress: Progress | None = None,
) -> Encoded:
    """Encode an image [H, W, 3], values in [0, 1], within a budget.

    profile: one of sgmethod.profiles.PROFILE_NAMES; seed: of everything random, so that the same call gives
    the same file on the same machine unless time_limit_s (seconds, whole encode) cuts it short;
    on_progress: called with each point of the trace, and may raise to abandon the encode.

    Raises ImageError for an array that is no such image, BudgetError for a budget no file can meet.
    """
    settings = _settings(profile)
    _check_image(pixels)
    if time_limit_s is not None and not (math.isfinite(time_limit_s) and time_limit_s > 0):
        raise BudgetError(f"the time limit must be a positive number of seconds, got {time_limit_s}")
    pixels = np.ascontiguousarray(pixels, np.float32)
    encoder = _Encoder(pixels, profile, settings, seed, Recorder(Clock(time_limit_s), on_progress))
    height, width = pixels.shape[:2]
    with _single_torch_thread():
        if budget.kind == "psnr":
            stream = encoder.reach_psnr(budget.value)
        elif budget.kind == "gaussians":
            stream = encoder.with_gaussians(_checked_count(budget, width * height))
        else:
            stream = encoder.within_bytes(budget.max_bytes(width, height) or 0)
    return encoder.finish(stream)


def _settings(profile: str) -> Settings:
    if profile not in PROFILES:
        raise BudgetError(f"unknown profile {profile!r}; use one of {', '.join(PROFILES)}")
    return PROFILES[profile]


def _check_image(pixels: NDArray[np.float32]) -> None:
    if pixels.ndim != 3 or pixels.shape[2] != 3 or 0 in pixels.shape:
        raise ImageError(f"an image must be [height, width, 3], got {list(pixels.shape)}")
    if max(pixels.shape) > bitstream.MAX_SIDE:
        raise ImageError(f"a side of {max(pixels.shape)} pixels is more than {bitstream.MAX_SIDE}")
    if not np.isfinite(pixels).all() or pixels.min() < 0 or pixels.max() > 1:
        raise ImageError("the image's values must lie in [0, 1]")


def _checked_count(budget: Budget, pixels: int) -> int:
    if budget.value > pixels:
        raise BudgetError(f"{int(budget.value)} Gaussians are more than the image's {pixels} pixels")
    return int(budget.value)


class _single_torch_thread:  # noqa: N801 - reads as a statement
    """Torch's own thread pool is kept out of the way: two pools on the same cores cost several times the time."""

    def __enter__(self) -> None:
        self.threads = torch.get_num_threads()
        torch.set_num_threads(1)

    def __exit__(self, *_: object) -> None:
        torch.set_num_threads(self.threads)


@dataclass
class _Encoder:
    pixels: NDArray[np.float32]
    profile: str
    settings: Settings
    seed: int
    recorder: Recorder
    steps: int = 0

    def within_bytes(self, max_bytes: int) -> Stream:
        """The best stream of at most max_bytes."""
        height, width = self.pixels.shape[:2]
        s = self.settings
        groups = s.max_bitwidth - s.min_bitwidth + 1 if s.adaptive_bitwidth else 1
        bits = bitstream.record_budget_bits(max_bytes, groups)
        least = bits_per_gaussian(replace(s, mean_bitwidth=s.min_bitwidth))
        if bits < least:
            smallest = max_bytes + math.ceil((least - bits) / 8)
            raise BudgetError(
                f"a file of profile {self.profile} takes at least {smallest} bytes, the budget is {max_bytes}"
            )
        n = min(max(int(bits // bits_per_gaussian(s)), 1), width * height)
        return self._run(n, bits)

    def with_gaussians(self, n: int) -> Stream:
        """A stream of n Gaussians, its bitwidths set by lambda_b."""
        return self._run(n, None)

    def reach_psnr(self, target_db: float) -> Stream:
        """The smallest stream found that reaches target_db, else the best found.

        Each attempt is a whole encode; the next number of Gaussians follows from the slope of PSNR over the
        logarithm of that number.
        """
        pixels = self.pixels.shape[0] * self.pixels.shape[1]
        n = max(pixels // 300, 1)
        tried: dict[int, tuple[float, Stream]] = {}
        limit = self.recorder.clock.limit_s
        for attempt in range(PSNR_ATTEMPTS):
            share = None if limit is None else limit * (attempt + 1) / PSNR_ATTEMPTS
            stream = self._run(n, None, share)
            tried[n] = (self.measure(bitstream.serialise(stream)), stream)
            n = _next_count(tried, target_db, pixels)
            if n in tried:
                break
        reached = [m for m, (db, _) in tried.items() if db >= target_db]
        return tried[min(reached)][1] if reached else max(tried.values(), key=lambda t: t[0])[1]

    def _run(self, n: int, record_bits: int | None, until_s: float | None = None) -> Stream:
        clock = self.recorder.clock
        until_s = clock.limit_s if until_s is None else until_s
        begun, fit_until, tune_until = clock.seconds(), None, None
        if until_s is not None:
            megapixels = self.pixels.shape[0] * self.pixels.shape[1] / 1e6
            tune_until = until_s - RESERVE_S - RESERVE_S_PER_MEGAPIXEL * megapixels
            fit_until = begun + FIT_SHARE * (tune_until - begun)
        picture = Picture(self.pixels, self.settings.lambda_g)
        start = place(self.pixels, n, self.settings, np.random.default_rng(self.seed))
        fitted, fit_steps = fit(picture, start, self.settings, self.recorder, fit_until)
        job = Job(picture, self.settings, record_bits, tune_until, self.seed)
        stream, tune_steps = tune(fitted, job, self.recorder, self.profile)
        self.steps += fit_steps + tune_steps
        return stream

    def measure(self, data: bytes) -> float:
        """PSNR in dB of a file's pixels against the source at 8 bits."""
        return psnr(decode(data), self._source())

    def _source(self) -> NDArray[np.uint8]:
        return np.round(self.pixels * 255).astype(np.uint8)

    def finish(self, stream: Stream) -> Encoded:
        """Serialise, decode the very bytes and measure them."""
        data = bitstream.serialise(stream)
        decoded, source = decode(data), self._source()
        height, width = source.shape[:2]
        db = psnr(decoded, source)
        self.recorder.report("done", self.steps, self.steps, 10 ** (-db / 10), (stream.gaussians, 8 * len(data)))
        stats = Stats(
            bytes=len(data),
            bpp=8 * len(data) / (width * height),
            psnr=db,
            ms_ssim=ms_ssim(decoded, source),
            gaussians=stream.gaussians,
            steps=self.steps,
            seconds=self.recorder.clock.seconds(),
            width=width,
            height=height,
            profile=self.profile,
        )
        return Encoded(data, stats, self.recorder.points)


def _next_count(tried: dict[int, tuple[float, Stream]], target_db: float, most: int) -> int:
    """The number of Gaussians to try next, from the two attempts nearest to the target."""
    nearest = sorted(tried, key=lambda m: abs(tried[m][0] - target_db))[:2]
    n, db = nearest[0], tried[nearest[0]][0]
    slope = PSNR_PER_DOUBLING_DB
    if len(nearest) == 2 and nearest[0] != nearest[1]:
        other = nearest[1]
        slope = (db - tried[other][0]) / math.log2(n / other)
        slope = min(max(slope, 0.5), 6.0)
    aim = target_db + 0.05  # a little above, so that the last attempt rather meets the target than misses it
    doublings = min(max((aim - db) / slope, -4.0), 4.0)
    return min(max(round(n * 2**doublings), 1), most)
