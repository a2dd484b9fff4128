"""What an encode returns: the file, its figures and its trace.

The file is decoded once, so the figures describe the actual bytes.
"""

from __future__ import annotations

import math
import os
import statistics
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field

from sgmethod.decoder import SgFile
from sgmethod.encode_arguments import EncodeArguments
from sgmethod.errors import SgError
from sgmethod.fitting.recorder import Recorder
from sgmethod.io.compositing import on_backgrounds
from sgmethod.io.files import checked_path, write_atomically
from sgmethod.io.formats import OTHER_SUFFIXES, SUFFIXES
from sgmethod.metrics import psnr, ssimulacra2
from sgmethod.scene import Pixels
from sgmethod.trace import TracePoint

REPORTED_MISS_DB = 0.005  # a smaller miss rounds to 0.00 dB
FULL = 0.9  # of the bytes that are allowed beside a quality: a file that has used them misses nothing it could reach
REPORTED_MISS_QUALITY = 1.0  # points of SSIMULACRA 2; a smaller miss counts as met


@dataclass(frozen=True)
class Stats:
    """The figures of an encode.

    psnr (dB) and ssimulacra2 (up to 100) describe the decoded file; with alpha, over black and over white. ssimulacra2
    is None for sides below 8 pixels, and unless encode() was asked to measure it or to reach a quality.
    source_bytes: size of the image file, None for arrays; psnr_missed_db, quality_missed:
    how far the file is below the requested PSNR or SSIMULACRA 2, None if none was requested, or its bytes are used up.
    """

    bytes: int
    bpp: float
    psnr: float
    ssimulacra2: float | None
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


def measured(
    pixels: Pixels, data: bytes, steps: int, recorder: Recorder, asked: EncodeArguments, measure: bool
) -> Stats:
    """Decode a file and measure it against pixels. measure: SSIMULACRA 2 too."""
    file, budget = SgFile(data), asked.budget
    assert asked.effort is not None  # for_size() has chosen one
    decoded, source = on_backgrounds(file.pixels()), on_backgrounds(pixels)
    height, width = pixels.shape[:2]
    db, gaussians = psnr(decoded, source), file.info.gaussians
    allowed = budget.max_bytes(width, height)
    must_reach = budget.kind == "quality" and (allowed is None or len(data) < FULL * allowed)
    score = _mean(map(ssimulacra2, decoded, source)) if measure or budget.kind == "quality" else None
    recorder.report("done", steps, steps, 10 ** (-db / 10), gaussians, len(data))
    return Stats(
        bytes=len(data),
        bpp=8 * len(data) / (width * height),
        psnr=db,
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
        quality_missed=max(budget.value - score, 0.0) if must_reach and score is not None else None,
    )


def _mean(figures: Iterable[float | None]) -> float | None:
    """Mean of the figures that are not None; None if all are."""
    found = [one for one in figures if one is not None]
    return statistics.fmean(found) if found else None
