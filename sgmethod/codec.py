"""Encoding: a request, the pipeline of its profile (rd/encode.py, paper/encode.py), and the file measured.

decode.py is the way back. An encode goes it once, so that its figures are those of the very bytes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from sgmethod.budget import Budget
from sgmethod.decode import MAX_PIXELS, decode, info
from sgmethod.errors import BudgetError, ImageError
from sgmethod.fitting.recorder import Clock, Recorder
from sgmethod.fitting.request import Request
from sgmethod.io.image import ImageLimits, to_8_bit
from sgmethod.metrics import ms_ssim, psnr
from sgmethod.paper import encode as paper
from sgmethod.profiles import DEFAULT_PROFILE, PROFILES, RdSettings
from sgmethod.rd import encode as rd
from sgmethod.trace import Progress, TracePoint


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
    pixels: NDArray[np.float32] | NDArray[np.uint8],
    budget: Budget,
    profile: str = DEFAULT_PROFILE,
    *,
    seed: int = 0,
    time_limit_s: float | None = None,
    on_progress: Progress | None = None,
) -> Encoded:
    """Encode an image [H, W, 3], of levels in uint8 or of values in [0, 1], within a budget.

    Values are rounded to levels: a decoded picture has no others, and its figures are against them.
    profile: one of sgmethod.profiles.PROFILE_NAMES; seed: of everything random, so that the same call gives
    the same file on the same machine unless time_limit_s (seconds, whole encode) cuts it short;
    on_progress: called with each point of the trace, and may raise to abandon the encode.

    Raises ImageError for an array that is no such image, BudgetError for a budget no file can meet, MemoryError.
    """
    _check_image(pixels)
    _check_profile(profile)
    _check_time_limit(time_limit_s)
    recorder = Recorder(Clock(time_limit_s), on_progress)
    request = Request(to_8_bit(pixels), budget, profile, seed, recorder)
    settings = PROFILES[profile]
    with _single_torch_thread(), _memory_errors():
        if isinstance(settings, RdSettings):
            data, steps = rd.encode(request, settings)
        else:
            data, steps = paper.encode(request, settings)
    return _measured(request, data, steps)


@contextmanager
def _single_torch_thread() -> Iterator[None]:
    """Keep torch's own threads out of the way: two pools on the same cores cost several times the time."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@contextmanager
def _memory_errors() -> Iterator[None]:
    """Torch says with a RuntimeError of its own what everybody else says with MemoryError."""
    try:
        yield
    except RuntimeError as error:
        if "can't allocate memory" not in str(error):
            raise
        raise MemoryError("there is not enough memory for this encode") from error


def _measured(request: Request, data: bytes, steps: int) -> Encoded:
    """Decode the very bytes and measure them."""
    decoded, source = decode(data), request.pixels
    height, width = source.shape[:2]
    db, gaussians = psnr(decoded, source), info(data).gaussians
    request.recorder.report("done", steps, steps, 10 ** (-db / 10), (gaussians, 8 * len(data)))
    stats = Stats(
        bytes=len(data),
        bpp=8 * len(data) / (width * height),
        psnr=db,
        ms_ssim=ms_ssim(decoded, source),
        gaussians=gaussians,
        steps=steps,
        seconds=request.recorder.clock.seconds(),
        width=width,
        height=height,
        profile=request.profile,
    )
    return Encoded(data, stats, request.recorder.points)


def _check_image(pixels: NDArray[np.float32] | NDArray[np.uint8]) -> None:
    if pixels.ndim != 3 or pixels.shape[2] != 3 or 0 in pixels.shape:
        raise ImageError(f"an image must be [height, width, 3], got {list(pixels.shape)}")
    height, width = pixels.shape[:2]
    ImageLimits(max_pixels=MAX_PIXELS).check(width, height)  # no more than decode() gives back
    if pixels.dtype == np.uint8:
        return
    if not np.issubdtype(pixels.dtype, np.floating):
        raise ImageError(f"an image must be uint8 or hold floating-point values in [0, 1], got {pixels.dtype}")
    if not np.isfinite(pixels).all() or pixels.min() < 0 or pixels.max() > 1:
        raise ImageError("the image's values must lie in [0, 1]")


def _check_profile(profile: str) -> None:
    if profile not in PROFILES:
        raise BudgetError(f"unknown profile {profile!r}; use one of {', '.join(PROFILES)}")


def _check_time_limit(seconds: float | None) -> None:
    if seconds is not None and not (math.isfinite(seconds) and seconds > 0):
        raise BudgetError(f"the time limit must be a positive number of seconds, got {seconds}")
