"""Encoding: run a profile's pipeline (rd/encode.py or paper/encode.py) and measure the file.

The file is decoded once, so the reported figures describe the actual bytes.
"""

from __future__ import annotations

import builtins
import math
import os
import statistics
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from sgmethod.arguments import AnyFloat, AnyInt, checked_integer, finite_number
from sgmethod.backend.kernels import Kernels
from sgmethod.bitstream import container
from sgmethod.bitstream.container import smallest_file
from sgmethod.budget import DEFAULT_BUDGET, Budget, BudgetKind, QualityName, default_budget
from sgmethod.decoder import SgFile
from sgmethod.errors import BudgetError, ImageError, SgError
from sgmethod.fitting.deadline import Clock, Deadline
from sgmethod.fitting.objective import Objective
from sgmethod.fitting.recorder import Recorder
from sgmethod.io.compositing import on_backgrounds
from sgmethod.io.files import checked_path, write_atomically
from sgmethod.io.formats import OTHER_SUFFIXES, SUFFIXES
from sgmethod.io.image import Input, read_input
from sgmethod.metrics import ms_ssim, psnr, ssimulacra2
from sgmethod.numerics import quiet
from sgmethod.profiles import DEFAULT_PROFILE, Profile, checked_effort, checked_profile, profile_of, settings_of, tuning
from sgmethod.rd import alpha, encode as rd
from sgmethod.rd.budgets import rate_of
from sgmethod.rd.byte_limit import ByteBudget
from sgmethod.rd.request import Request
from sgmethod.scene import Pixels
from sgmethod.settings.paper import PaperSettings
from sgmethod.settings.rd import DEFAULT_EFFORT, RdSettings
from sgmethod.settings.shared import Tune
from sgmethod.trace import Preview, Progress, Stop, TracePoint

REPORTED_MISS_DB = 0.005  # a smaller miss rounds to 0.00 dB
REPORTED_MISS_QUALITY = 1.0  # points of SSIMULACRA 2; a smaller miss counts as met

MAX_SEED = 2**63 - 1  # a seed of torch is below 2^64, and each stage of a codebook adds to it


@dataclass(frozen=True)
class Stats:
    """The figures of an encode.

    psnr (dB), ms_ssim and ssimulacra2 (up to 100) describe the decoded file. ms_ssim and ssimulacra2 are None unless
    encode() was asked to measure them, and for sides below 161 and 8 pixels; ssimulacra2 is also measured for a
    quality to reach. With alpha, all three compare the picture over black and over white. effort: None if encode() was
    given settings; source_bytes: size of the image file, None for arrays; psnr_missed_db, quality_missed: how far the
    file is below the requested PSNR or SSIMULACRA 2, None if none was requested.
    """

    bytes: int
    bpp: float
    psnr: float
    ms_ssim: float | None
    ssimulacra2: float | None
    gaussians: int
    steps: int
    seconds: float
    width: int
    height: int
    profile: str
    tune: str
    effort: int | None
    source_bytes: int | None = None
    psnr_missed_db: float | None = None
    quality_missed: float | None = None

    @property
    def warnings(self) -> list[str]:
        """Possible disappointments, one sentence each."""
        found = []
        if self.psnr_missed_db is not None and self.psnr_missed_db >= REPORTED_MISS_DB:
            missed = f"{self.psnr_missed_db:.2f} dB: the file has {self.psnr:.2f} dB"
            found.append(f"the requested PSNR is missed by {missed}")
        if self.quality_missed is not None and self.quality_missed >= REPORTED_MISS_QUALITY:
            missed = f"{self.quality_missed:.1f}: the file has {self.ssimulacra2:.1f}"
            found.append(f"the requested quality is missed by {missed}")
        has_aim = self.psnr_missed_db is not None or self.quality_missed is not None
        if not has_aim and self.gaussians == 0 and math.isfinite(self.psnr):
            found.append("the file contains only a background and no Gaussians: try a larger budget")
        if self.source_bytes is not None and self.bytes > self.source_bytes:
            found.append(f"the file is larger than its source: {self.bytes:,} bytes, source {self.source_bytes:,}")
        return found

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON types, warnings included; psnr is None for a lossless result."""
        psnr = self.psnr if math.isfinite(self.psnr) else None
        return {**asdict(self), "psnr": psnr, "warnings": self.warnings}


@dataclass(frozen=True)
class Encoded:
    """An .sg file with its figures and its trace."""

    data: bytes = field(repr=False)
    stats: Stats
    trace: list[TracePoint] = field(repr=False)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the file completely, or raise OSError and leave the path as it was.

        Raises SgError for the name of a picture, such as photo.jpg: no program would open the file.
        """
        target = checked_path(path)
        if target.suffix.lower() in SUFFIXES | OTHER_SUFFIXES:
            raise SgError(f"{target} names a picture, and this is an .sg file: use {target.with_suffix('.sg')}")
        write_atomically(target, self.data)


@quiet
def encode(
    image: Input,
    budget: Budget | None = None,
    profile: Profile = DEFAULT_PROFILE,
    *,
    bpp: AnyFloat | None = None,
    bytes: AnyInt | str | None = None,
    quality: AnyFloat | QualityName | None = None,
    psnr: AnyFloat | None = None,
    gaussians: AnyInt | None = None,
    tune: Tune | None = None,
    effort: AnyInt = DEFAULT_EFFORT,
    settings: RdSettings | PaperSettings | None = None,
    seed: AnyInt = 0,
    time_limit_s: AnyFloat | None = None,
    on_progress: Progress | None = None,
    stop: Stop | None = None,
    on_preview: Preview | None = None,
    measure: bool = False,
) -> Encoded:
    """Encode a picture within a budget.

    >>> encoded = sgmethod.encode("photo.jpg", bpp=0.3)
    >>> encoded.stats.bpp <= 0.3
    True
    >>> encoded.save("photo.sg")
    >>> sgmethod.encode(np.zeros((48, 64), np.uint8), psnr=40).stats.width
    64

    image: the path or bytes of an image file, a Pillow image, or an sRGB array [H, W], [H, W, 1], [H, W, 3] or [H, W,
    4] in uint8, uint16 or floating point in [0, 1]. sgmethod/io/image.py has the rules for files. Input is rounded to 8
    bits, and the figures are relative to that. Profile rd keeps alpha; the others composite it over white, with a
    warning.
    bpp, bytes, quality, psnr, gaussians: at most one of these, or a Budget, which documents them; the default is
    0.3 bpp, but at most 50,000 bytes.
    profile: "rd" or "paper".
    tune: "visual" (the default of profile rd) optimises for the eye, "psnr" for squared error. Budgets in dB and other
    profiles support only "psnr".
    effort: 1 (fastest) to 9 (best file); profile rd only.
    settings: all parameters of the method, for experiments; replaces profile and effort.
    seed: random seed. Without a time limit, the same call gives the same file on the same machine.
    time_limit_s: limit for the whole encode, which uses it up unless it needs less. About 0.1 s per megapixel, divided
    by the cores, is needed in any case.
    on_progress: called with each point of the trace; if it raises, the encode is abandoned.
    stop: polled; once it returns True, the encode finishes within its budget, in a quarter of the time so far, at most
    3 s.
    on_preview: called from time to time by profile rd with a file of its current state, which may exceed the budget.
    measure: also measure MS-SSIM and SSIMULACRA 2, which takes a large part of the time of a small encode.

    Anything dropped from the input raises an ImageWarning. Raises ImageError for anything that is not a picture,
    BudgetError for a budget that no file can meet, OSError for a path that cannot be read, and MemoryError.
    """
    clock, limit_s = Clock(stop), _checked_time_limit(time_limit_s)
    kinds: dict[BudgetKind, Any] = {"bpp": bpp, "bytes": bytes, "quality": quality, "psnr": psnr}
    only = _only_budget(budget, kinds | {"gaussians": gaussians})
    asked = _EncodeArguments.checked(only, profile, tune, effort, settings, seed)
    pixels = read_input(image, keep_alpha=isinstance(asked.settings, RdSettings))
    source_bytes = _file_bytes(image)  # now, as the file may be deleted meanwhile
    asked = asked.with_default_for(pixels)
    deadline_settings = asked.settings.deadline if isinstance(asked.settings, RdSettings) else None
    deadline = Deadline.from_limit(clock, limit_s, pixels.shape[0] * pixels.shape[1], deadline_settings)
    recorder = Recorder(clock, on_progress, on_preview)
    data, steps = _run(pixels, asked, deadline, recorder)
    stats = _measured(pixels, data, steps, recorder, asked, measure)
    return Encoded(data, replace(stats, source_bytes=source_bytes), recorder.points)


@dataclass(frozen=True)
class _EncodeArguments:
    """The checked arguments of an encode. effort: None if the caller gave settings."""

    budget: Budget
    profile: Profile
    tune: Tune
    effort: int | None
    settings: RdSettings | PaperSettings
    seed: int

    @classmethod
    def checked(
        cls,
        budget: Budget,
        profile: Profile,
        tune: Tune | None,
        effort: AnyInt,
        settings: RdSettings | PaperSettings | None,
        seed: AnyInt,
    ) -> _EncodeArguments:
        """Check the arguments of encode(). Raises BudgetError."""
        seed = checked_integer(seed, "the seed", 0, MAX_SEED, BudgetError)
        profile = checked_profile(profile) if settings is None else profile_of(settings)
        tuned_for = tuning(tune, profile, budget)
        if settings is not None:
            return cls(budget, profile, tuned_for, None, settings, seed)
        effort = checked_effort(effort)
        return cls(budget, profile, tuned_for, effort, settings_of(profile, effort), seed)

    def with_default_for(self, pixels: Pixels) -> _EncodeArguments:
        """Replace the default budget by what it is for a picture [H, W, C]."""
        if self.budget is not DEFAULT_BUDGET:
            return self
        height, width, channels = pixels.shape
        least = smallest_file(self.settings, has_alpha=channels == 4)
        return replace(self, budget=default_budget(width, height, least))


def _file_bytes(image: Input) -> int | None:
    """Size of the image file; None for Pillow images and arrays."""
    if isinstance(image, str | os.PathLike):
        return checked_path(image, ImageError).stat().st_size or None  # 0 for a pipe
    return memoryview(image).nbytes if isinstance(image, bytes | bytearray | memoryview) else None


def _run(pixels: Pixels, asked: _EncodeArguments, deadline: Deadline, recorder: Recorder) -> tuple[builtins.bytes, int]:
    """Encode pixels [H, W, 3], or [H, W, 4] with profile rd; return the file and its number of steps."""
    budget, settings, seed, backend = asked.budget, asked.settings, asked.seed, Kernels()
    if isinstance(settings, PaperSettings):
        from sgmethod.paper import encode as paper  # imports torch

        return paper.encode(paper.Request(pixels, budget, asked.profile, settings, deadline, recorder, backend, seed))
    height, width, channels = pixels.shape
    objective = Objective.from_pixels(np.ascontiguousarray(pixels[..., :3]), asked.tune, settings.objective)
    rate = rate_of(budget, (width, height), settings, has_alpha=channels == 4)
    if isinstance(rate, ByteBudget) and rate.is_short and objective.histogram.has_majority:
        rate = rate.for_exact_background(channels == 4)
    request = Request(objective, rate, deadline, backend, settings, recorder, seed)
    if channels == 4:
        stream, steps = alpha.encode(request, np.ascontiguousarray(pixels[..., 3]))
    else:
        stream, steps = rd.encode(request)
    return container.serialise(stream), steps


def _only_budget(budget: Budget | None, kinds: dict[BudgetKind, Any]) -> Budget:
    """Return the budget given, or the default. Raises BudgetError for more than one."""
    given = [Budget(kind, value) for kind, value in kinds.items() if value is not None]
    if budget is not None:
        if not isinstance(budget, Budget):
            raise BudgetError(f"a budget must be a sgmethod.Budget, not {type(budget).__name__}; or use bpp=0.3")
        given.append(budget)
    if len(given) > 1:
        raise BudgetError(f"give one budget, not {len(given)}: {', '.join(one.kind for one in given)}")
    return given[0] if given else DEFAULT_BUDGET


def _measured(
    pixels: Pixels, data: builtins.bytes, steps: int, recorder: Recorder, asked: _EncodeArguments, measure: bool
) -> Stats:
    """Decode a file and measure it against pixels. measure: MS-SSIM and SSIMULACRA 2 too."""
    file, budget = SgFile(data), asked.budget
    decoded, source = on_backgrounds(file.pixels()), on_backgrounds(pixels)
    height, width = pixels.shape[:2]
    db, gaussians = psnr(decoded, source), file.info.gaussians
    similarity = _mean(map(ms_ssim, decoded, source)) if measure else None
    score = _mean(map(ssimulacra2, decoded, source)) if measure or budget.kind == "quality" else None
    recorder.report("done", steps, steps, 10 ** (-db / 10), gaussians, len(data))
    return Stats(
        bytes=len(data),
        bpp=8 * len(data) / (width * height),
        psnr=db,
        ms_ssim=similarity,
        ssimulacra2=score,
        gaussians=gaussians,
        steps=steps,
        seconds=recorder.points[-1].seconds,
        width=width,
        height=height,
        profile=asked.profile,
        tune=asked.tune,
        effort=asked.effort,
        psnr_missed_db=max(budget.value - db, 0.0) if budget.kind == "psnr" else None,
        quality_missed=max(budget.value - score, 0.0) if budget.kind == "quality" and score is not None else None,
    )


def _mean(figures: Iterable[float | None]) -> float | None:
    """Mean of the figures that are not None; None if all are."""
    found = [one for one in figures if one is not None]
    return statistics.fmean(found) if found else None


def _checked_time_limit(seconds: AnyFloat | None) -> float | None:
    if seconds is None:
        return None
    number = finite_number(seconds)
    if number is None or not 0 < number <= sys.float_info.max:
        raise BudgetError(f"the time limit must be a positive number of seconds, got {seconds!r}")
    return float(number)
