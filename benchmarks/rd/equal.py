"""Codecs at equal bytes: figures interpolated to one size, and differences picture by picture."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from benchmarks.perceptual.photographs import grouped
from benchmarks.rd.report import LESS_IS_BETTER, QUALITIES, TITLES, Row
from benchmarks.tables import number, standard_error, table

FORMS = {"psnr": ".2f", "ssimulacra2": ".2f", "lpips": ".4f", "dists": ".4f"}
FORMS |= {"ms_ssim": ".4f", "butteraugli": ".3f", "cvvdp": ".3f"}


@dataclass(frozen=True)
class Difference:
    """The figures of two codecs over the pictures of which both have files of that size, and what the first gains."""

    pictures: int
    ours: float
    theirs: float
    gain: float  # positive or negative, as the figure is
    standard_error: float | None
    better: int  # pictures on which the first is better


def between(smaller: Row, larger: Row) -> Row:
    """A row of exactly the rate: figures interpolated along the logarithm of bytes."""
    share = math.log(smaller.aim / smaller.bpp) / math.log(larger.bpp / smaller.bpp)
    found: dict[str, Any] = {}
    for name in QUALITIES:
        ends = getattr(smaller, name), getattr(larger, name)
        if None not in ends:
            found[name] = ends[0] + share * (ends[1] - ends[0])
    return replace(smaller, bytes=round(smaller.bytes * smaller.aim / smaller.bpp), bpp=smaller.aim, **found)


def difference(rows: Sequence[Row], ours: str, theirs: str, bpp: float, figure: str) -> Difference | None:
    """Compare two codecs at a rate. None where no picture has both, or the figure is missing."""
    values: dict[tuple[str, str], float] = {}
    for row in rows:
        value = getattr(row, figure)
        if row.max_bpp == bpp and row.bpp <= bpp and value is not None:
            values[row.codec, row.image] = value
    images = [image for codec, image in values if codec == ours and (theirs, image) in values]
    if not images:
        return None
    first, second = ([values[codec, image] for image in images] for codec in (ours, theirs))
    gains = [one - other for one, other in zip(first, second, strict=True)]
    better = sum(gain < 0 if figure in LESS_IS_BETTER else gain > 0 for gain in gains)
    ours_mean, theirs_mean, gain = (statistics.fmean(values) for values in (first, second, gains))
    error = standard_error(gains, grouped(images))
    return Difference(len(images), ours_mean, theirs_mean, gain, error, better)


def differences_table(rows: Sequence[Row], ours: Sequence[str], theirs: Sequence[str]) -> str:
    """A line for each rate, pair of codecs and figure."""
    lines = []
    for bpp in dict.fromkeys(row.max_bpp for row in rows if row.max_bpp is not None):
        for one in ours:
            for other in theirs:
                for figure, form in FORMS.items():
                    if found := difference(rows, one, other, bpp, figure):
                        lines.append([f"{bpp:g}", one, other, TITLES[figure], *cells(found, form)])
    return table("bpp | codec | against | figure | of it | of the other | difference | better on", lines)


def cells(found: Difference, form: str) -> list[str]:
    """Both means, the difference with its standard error, and on how many pictures the first is better."""
    error = number(found.standard_error, form)
    values = [number(found.ours, form), number(found.theirs, form), f"{number(found.gain, f'+{form}')} ± {error}"]
    return [*values, f"{found.better} of {found.pictures}"]
