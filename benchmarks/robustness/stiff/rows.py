"""One encode of one picture as a row: what was asked for, what came of it, and the best that its trace had shown."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.pictures import Pixels
from sgmethod import Budget, BudgetError, Encoded, encode
from sgmethod.bitstream import container
from sgmethod.native import native

# What rounding to 8 bits leaves of a perfect picture: an error of 1/12 of a squared level. No better one is asked for.
EXACT_DB = 58.9


@dataclass(frozen=True)
class Row:
    """One encode; the fields of the JSON.

    value: the budget, in the unit of its kind; max_bytes: what a budget of kind bpp allows; bytes: of the file, None
    where there is none; psnr: dB of the decoded file, None for identical pixels and where there is no file; traced:
    bytes, PSNR and phase of the best point of the trace at the file's size; clipped: numbers that the encode clipped,
    and those of the file that are not finite; refused: why no file fits in a budget of kind bpp; error: what else
    ended the encode.
    """

    picture: str
    seed: int
    kind: str
    value: float
    max_bytes: int | None = None
    bytes: int | None = None
    psnr: float | None = None
    gaussians: int | None = None
    seconds: float | None = None
    traced: tuple[int, float, str] | None = None
    clipped: int = 0
    refused: str | None = None
    error: str | None = None

    @property
    def size(self) -> int:
        """The file's bytes, where there is a file."""
        assert self.bytes is not None
        return self.bytes

    @property
    def most(self) -> int:
        """The bytes allowed, where the budget sets a size."""
        assert self.max_bytes is not None
        return self.max_bytes

    @property
    def db(self) -> float:
        """The file's PSNR, at most EXACT_DB: what lies beyond is no difference that counts."""
        return EXACT_DB if self.psnr is None else min(self.psnr, EXACT_DB)


def measure(picture: str, pixels: Pixels, seed: int, budget: Budget) -> Row:
    """Encode a picture [H, W, 3] once. An encode that fails is a row too: others follow."""
    height, width = pixels.shape[:2]
    max_bytes = budget.max_bytes(width, height)
    asked = Row(picture, seed, budget.kind, budget.value, max_bytes)
    clipped_before = native.rd_clipped_values()
    try:
        encoded = encode(pixels, budget, tune="psnr", seed=seed)
    except Exception as error:
        why = f"{type(error).__name__}: {error}"
        small = isinstance(error, BudgetError) and max_bytes is not None
        return replace(asked, refused=why) if small else replace(asked, error=why)
    stats = encoded.stats
    known = [point for point in encoded.trace if 0 < point.bytes <= stats.bytes]
    best = max(known, key=lambda point: point.psnr, default=None)
    return replace(
        asked,
        bytes=stats.bytes,
        psnr=stats.psnr if math.isfinite(stats.psnr) else None,
        gaussians=stats.gaussians,
        seconds=round(stats.seconds, 2),
        traced=(best.bytes, best.psnr, best.phase) if best else None,
        clipped=native.rd_clipped_values() - clipped_before + not_finite(encoded),
    )


def not_finite(encoded: Encoded) -> int:
    """How many numbers of the file's Gaussians are not finite."""
    gaussians = container.parse(encoded.data).scene().gaussians
    numbers = (gaussians.means, gaussians.factors, gaussians.colors)
    return sum(int(np.count_nonzero(~np.isfinite(values))) for values in numbers)
