"""Encoding: a request, the pipeline of its profile (rd/encode.py, paper/encode.py), and the file measured.

decode.py is the way back. An encode goes it once, so that its figures are those of the very bytes.
"""

from __future__ import annotations

import math
import os
import statistics
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from sgmethod.bitstream.smallest import smallest_file
from sgmethod.budget import DEFAULT_BUDGET, Budget, BudgetKind, own_number, unasked, whole
from sgmethod.decoder import SgFile
from sgmethod.errors import BudgetError
from sgmethod.fitting.recorder import Clock, Recorder
from sgmethod.fitting.request import Request
from sgmethod.io.files import own_path, write_atomically
from sgmethod.io.inputs import Input, read_input
from sgmethod.io.laying import on_backgrounds
from sgmethod.metrics import ms_ssim, psnr
from sgmethod.paper import encode as paper
from sgmethod.profiles import DEFAULT_EFFORT, DEFAULT_PROFILE, PROFILES, RdSettings, checked_effort, tuning, with_effort
from sgmethod.rd import encode as rd
from sgmethod.trace import Preview, Progress, Stop, TracePoint

SEEN_DB = 0.005  # a smaller miss is none in two decimals
MAX_SEED = 2**63 - 1  # what torch takes, less the stages of a codebook


@dataclass(frozen=True)
class Stats:
    """What an encode came to. psnr and ms_ssim are of the decoded file; ms_ssim is None for small pictures. With alpha
    they are of the picture on black and on white, both together. source_bytes: of the image file, None where the image
    was none; psnr_missed_db: how far below the PSNR asked for the file is, None where none was asked for."""

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
    tune: str
    effort: int
    source_bytes: int | None = None
    psnr_missed_db: float | None = None

    @property
    def warnings(self) -> list[str]:
        """What the caller may not expect of the file, in a sentence each."""
        found = []
        if self.psnr_missed_db is not None and self.psnr_missed_db >= SEEN_DB:
            missed = f"{self.psnr_missed_db:.2f} dB: the file has {self.psnr:.2f} dB"
            found.append(f"the PSNR asked for is missed by {missed}")
        if self.psnr_missed_db is None and self.gaussians == 0 and math.isfinite(self.psnr):
            found.append("the file holds no Gaussian, only a background: it may take a larger budget")
        if self.source_bytes is not None and self.bytes > self.source_bytes:
            found.append(f"the file is larger than its source: {self.bytes:,} bytes in place of {self.source_bytes:,}")
        return found

    def to_dict(self) -> dict[str, object]:
        """Plain JSON types, warnings included; a lossless result has psnr None."""
        psnr = self.psnr if math.isfinite(self.psnr) else None
        return {**asdict(self), "psnr": psnr, "warnings": self.warnings}


@dataclass(frozen=True)
class Encoded:
    """An .sg file with its figures and the trace of how it came about."""

    data: bytes = field(repr=False)
    stats: Stats
    trace: list[TracePoint] = field(repr=False)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the file, whole or, after an OSError, not at all."""
        write_atomically(own_path(path), self.data)


def encode(
    image: Input,
    budget: Budget | None = None,
    profile: str = DEFAULT_PROFILE,
    *,
    bpp: float | None = None,
    bytes: int | None = None,
    psnr: float | None = None,
    quality: float | None = None,
    gaussians: int | None = None,
    tune: str | None = None,
    effort: int = DEFAULT_EFFORT,
    seed: int = 0,
    time_limit_s: float | None = None,
    on_progress: Progress | None = None,
    stop: Stop | None = None,
    on_preview: Preview | None = None,
) -> Encoded:
    """Encode a picture within a budget.

    >>> encoded = sgmethod.encode("photo.jpg", bpp=0.3)
    >>> encoded.stats.bpp <= 0.3
    True
    >>> encoded.save("photo.sg")
    >>> sgmethod.encode(np.zeros((48, 64), np.uint8), psnr=40).stats.width
    64

    image: the path or the bytes of an image file, a picture of Pillow's, or an array [H, W], [H, W, 1], [H, W, 3] or
    [H, W, 4] of levels in uint8 or uint16 or of values in [0, 1], in sRGB. sgmethod/io/image.py has the rules for
    files and pictures. All is rounded to 8 bits: a decoded picture has no more, and its figures are against them. What
    can be seen through stays so with profile rd; others lay it over white, with a warning.
    bpp, bytes, psnr, quality, gaussians: one of them, or a Budget, which says what each means; 0.3 bpp if not told.
    profile: one of sgmethod.profiles.PROFILE_NAMES; tune: what the file is to be good for, "psnr" (squared error) or
    "visual" (the eye; with profile rd, and no budget in dB), which is the default where it can be had; effort: from 1,
    the fastest, to 9, the best, with profile rd; seed: of everything random, so that the same call gives the same file
    on the same machine unless time_limit_s cuts it short, which ends a search with its best (seconds, whole encode, of
    which about 0.2 a megapixel are never cut); on_progress: called with each point of the trace, and may raise to
    abandon the encode; stop: asked all the time, and once it says True the encode ends early with what it has, within
    the budget, in about a quarter of the time so far; on_preview: called now and then by profile rd with a file of what
    there is, which is not held to the budget.

    Warns with ImageWarning of what of the picture is left out. Raises ImageError for what is no such picture,
    BudgetError for a budget no file can meet, OSError for a path that cannot be read, MemoryError.
    """
    recorder = Recorder(Clock(_own_time_limit(time_limit_s), stop), on_progress, on_preview)
    seed = whole(seed, "the seed", 0, MAX_SEED, BudgetError)
    kinds: dict[BudgetKind, float | None] = {
        "bpp": bpp,
        "bytes": bytes,
        "psnr": psnr,
        "quality": quality,
        "gaussians": gaussians,
    }
    budget = _only_budget(budget, kinds)
    _check_profile(profile)
    tuned_for = tuning(tune, profile, budget)
    effort = checked_effort(effort)
    settings = with_effort(PROFILES[profile], effort)
    pixels = read_input(image, keep_alpha=isinstance(settings, RdSettings))
    source_bytes = _file_bytes(image)
    alpha = np.ascontiguousarray(pixels[..., 3]) if pixels.shape[2] == 4 else None
    colours = np.ascontiguousarray(pixels[..., :3])
    if budget is DEFAULT_BUDGET:
        budget = unasked(pixels.shape[1], pixels.shape[0], smallest_file(settings, has_alpha=alpha is not None))
    request = Request(colours, budget, profile, tuned_for, effort, seed, recorder, alpha)
    with _torch_of_its_own(), _single_torch_thread(), _memory_errors():
        if isinstance(settings, RdSettings):
            data, steps = rd.encode(request, replace(settings, tune=tuned_for))
        else:
            data, steps = paper.encode(request, settings)
    encoded = _measured(request, pixels, data, steps)
    return replace(encoded, stats=replace(encoded.stats, source_bytes=source_bytes))


def _file_bytes(image: Input) -> int | None:
    """The size of the image file, if it is one."""
    if isinstance(image, str | os.PathLike):
        return Path(image).stat().st_size or None  # a pipe has none
    return memoryview(image).nbytes if isinstance(image, bytes | bytearray | memoryview) else None


def _only_budget(budget: Budget | None, kinds: dict[BudgetKind, float | None]) -> Budget:
    """The one that is given."""
    given = [Budget(kind, value) for kind, value in kinds.items() if value is not None]
    if budget is not None:
        if not isinstance(budget, Budget):
            raise BudgetError(f"a budget must be a sgmethod.Budget, not {type(budget).__name__}: bpp=0.3, for one")
        given.append(budget)
    if len(given) > 1:
        raise BudgetError(f"one budget is needed, not {len(given)}: {', '.join(one.kind for one in given)}")
    return given[0] if given else DEFAULT_BUDGET


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
def _torch_of_its_own() -> Iterator[None]:
    """Torch as it is at first, whatever the program has told it: float32 on the CPU, with gradients."""
    kind = torch.get_default_dtype()
    torch.set_default_dtype(torch.float32)
    try:
        with (
            torch.device("cpu"),
            torch.autocast("cpu", enabled=False),
            torch.inference_mode(False),
            torch.enable_grad(),
        ):
            yield
    finally:
        torch.set_default_dtype(kind)


@contextmanager
def _memory_errors() -> Iterator[None]:
    """Torch says with a RuntimeError of its own what everybody else says with MemoryError."""
    try:
        yield
    except RuntimeError as error:
        if "can't allocate memory" not in str(error):
            raise
        raise MemoryError("there is not enough memory for this encode") from error


def _measured(request: Request, pixels: NDArray[np.uint8], data: bytes, steps: int) -> Encoded:
    """Decode the very bytes and measure them against pixels [H, W, 3 or 4]."""
    file = SgFile(data)
    decoded, source = on_backgrounds(file.pixels()), on_backgrounds(pixels)
    height, width = pixels.shape[:2]
    db, gaussians = psnr(decoded, source), file.info.gaussians
    similar = [one for one in map(ms_ssim, decoded, source) if one is not None]
    request.recorder.report("done", steps, steps, 10 ** (-db / 10), (gaussians, 8 * len(data)))
    stats = Stats(
        bytes=len(data),
        bpp=8 * len(data) / (width * height),
        psnr=db,
        ms_ssim=statistics.fmean(similar) if similar else None,
        gaussians=gaussians,
        steps=steps,
        seconds=request.recorder.clock.seconds(),
        width=width,
        height=height,
        profile=request.profile,
        tune=request.tune,
        effort=request.effort,
        psnr_missed_db=max(request.budget.value - db, 0.0) if request.budget.kind == "psnr" else None,
    )
    return Encoded(data, stats, request.recorder.points)


def _check_profile(profile: str) -> None:
    if not isinstance(profile, str) or profile not in PROFILES:
        raise BudgetError(f"unknown profile {profile!r}; use one of {', '.join(PROFILES)}")


def _own_time_limit(seconds: float | None) -> float | None:
    if seconds is None:
        return None
    number = own_number(seconds)
    if number is None or not 0 < number <= sys.float_info.max:
        raise BudgetError(f"the time limit must be a positive number of seconds, got {seconds!r}")
    return float(number)
