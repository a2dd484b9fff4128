"""The report: means over the pictures, and differences in rate."""

from __future__ import annotations

import math
import statistics
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator, PPoly

from benchmarks import published
from benchmarks.tables import mean, number, table


@dataclass(frozen=True)
class Row:
    """One picture through one codec at one rate; the fields of the JSON."""

    codec: str
    max_bpp: float | None  # None where one quality was asked for
    image: str
    bytes: int
    bpp: float
    psnr: float | None  # None for identical pixels
    ms_ssim: float | None  # None for pictures too small for it
    gaussians: int | None
    encode_s: float | None
    decode_ms: float | None
    quality: float | None = None  # of profile rd, in place of max_bpp
    effort: int | None = None  # of profile rd; older files have the default and do not say so
    steps: int | None = None  # of a fit of profiles paper and baseline, None for their own number
    ssimulacra2: float | None = None  # None where no weights were given, as lpips and dists
    lpips: float | None = None
    dists: float | None = None

    @property
    def aim(self) -> float:
        """Bits per pixel at most, or the quality."""
        aim = self.quality if self.max_bpp is None else self.max_bpp
        assert aim is not None
        return aim

    @property
    def key(self) -> tuple[str, float, str]:
        """What makes a row one of its own."""
        return self.codec, self.aim, self.image


Point = tuple[float, float]  # bits per pixel, quality
Curve = Sequence[tuple[float | None, ...]]  # bits per pixel, PSNR, MS-SSIM
Means = dict[tuple[str, float], dict[str, float | None]]  # by codec and rate or quality, then by figure
ONE_QUALITY = "one quality"  # in the name of a codec whose pictures have one quality, and not one rate
FORMATS = {"images": "g", "bytes": ".0f", "bpp": ".3f", "psnr": ".2f", "ms_ssim": ".4f"}
SEEN = {"ssimulacra2": ".1f", "lpips": ".3f", "dists": ".3f"}
COSTS = {"gaussians": ".0f", "encode_s": ".3f", "decode_ms": ".2f"}
TITLES = {
    "images": "pictures",
    "above": "above it",
    "psnr": "PSNR",
    "ms_ssim": "MS-SSIM",
    "ssimulacra2": "SSIMULACRA 2",
    "lpips": "LPIPS",
    "dists": "DISTS",
    "gaussians": "Gaussians",
    "encode_s": "encode s",
    "decode_ms": "decode ms",
}


def bd_rate(anchor: Sequence[Point], test: Sequence[Point]) -> float | None:
    """Bjontegaard's difference in rate, in percent: what test needs more (or, below 0, less) than anchor.

    The mean over the qualities that both reach of the difference in log rate, each curve interpolated by piecewise
    cubic Hermite polynomials. None where they share no quality, or a curve has one point or falls. A point without
    error is on no curve.
    """
    curves = ([(x, math.log10(rate)) for rate, x in sorted(points) if math.isfinite(x)] for points in (anchor, test))
    gap = _mean_gap(*curves)
    return None if gap is None else 100 * (10**gap - 1)


def bd_quality(anchor: Sequence[Point], test: Sequence[Point]) -> float | None:
    """The same the other way: how much better test is, over the log rates that both reach. Of PSNR, it is BD-PSNR."""
    return _mean_gap(*([(math.log10(rate), quality) for rate, quality in sorted(points)] for points in (anchor, test)))


def _mean_gap(anchor: Sequence[Point], test: Sequence[Point]) -> float | None:
    """The mean of test less anchor over the x that both reach."""
    if any(len(points) < 2 or any(x >= after for (x, _), (after, _) in pairwise(points)) for points in (anchor, test)):
        return None
    low, high = max(anchor[0][0], test[0][0]), min(anchor[-1][0], test[-1][0])
    if low >= high:
        return None
    theirs, ours = (_integral(tuple(points)) for points in (anchor, test))
    return float((ours(high) - ours(low) - theirs(high) + theirs(low)) / (high - low))


@lru_cache(maxsize=10_000)
def _integral(points: tuple[Point, ...]) -> PPoly:
    """Of the curve through points, up to some x."""
    return PchipInterpolator(*np.array(points).T).antiderivative()


def means(rows: Sequence[Row]) -> Means:
    """For each codec and rate the mean of every figure over the pictures; None where a picture has none. images: how
    many they are; above: how many take more than was allowed."""
    groups = defaultdict(list)
    for row in rows:
        groups[row.codec, row.aim].append(row)
    figures = [name for name in (*FORMATS, *SEEN, *COSTS) if name != "images"]
    result = {}
    for key, group in groups.items():
        columns = {f: [getattr(row, f) for row in group] for f in figures}
        result[key] = {f: mean(values) for f, values in columns.items()}
        result[key]["images"] = len(group)
        result[key]["above"] = sum(row.max_bpp is not None and row.bpp > row.max_bpp for row in group)
    return result


def curve(average: Means, codec: str) -> Curve:
    """The mean points of a codec."""
    return [(m["bpp"], m["psnr"], m["ms_ssim"]) for (name, _), m in average.items() if name == codec]


def scaled(points: Curve, column: int) -> list[Point]:
    """(bits per pixel, quality) of a column."""
    return known([(p[0], p[column]) for p in points], "psnr" if column == 1 else "ms_ssim")


def known(pairs: Iterable[tuple[float | None, float | None]], figure: str) -> list[Point]:
    """(bits per pixel, quality), from bits per pixel and the figure where there are both."""
    return [(rate, quality(figure, value)) for rate, value in pairs if rate is not None and value is not None]


def quality(figure: str, value: float) -> float:
    """A figure so that more of it is better. Errors, and what MS-SSIM lacks of 1, are in decibels, as PSNR is."""
    error = {"ms_ssim": 1 - value, "lpips": value, "dists": value}.get(figure)
    if error is None:
        return value
    return -10 * math.log10(error) if error > 0 else math.inf


def against(rows: Sequence[Row], codec: str, anchor: str, figure: str = "psnr") -> tuple[float, int] | None:
    """The mean over pictures of each one's BD-rate for the same figure, and how many they are. None where one of the
    pictures that both have has no such rate."""
    rows = [row for row in rows if row.codec in (codec, anchor)]
    images = dict.fromkeys(row.image for row in rows if row.codec == anchor)
    return mean_rate({image: points(rows, anchor, image, figure) for image in images}, rows, codec, figure)


def mean_rate(
    anchors: dict[str, Sequence[Point]], rows: Sequence[Row], codec: str, figure: str = "psnr"
) -> tuple[float, int] | None:
    """The same, against points by picture."""
    images = [i for i in dict.fromkeys(row.image for row in rows if row.codec == codec) if i in anchors]
    rates = [bd_rate(anchors[image], points(rows, codec, image, figure)) for image in images]
    told = [rate for rate in rates if rate is not None]
    return (statistics.fmean(told), len(told)) if told and len(told) == len(rates) else None


def points(rows: Sequence[Row], codec: str, image: str, figure: str = "psnr") -> list[Point]:
    """Bits per pixel and quality of one picture; the smallest file that a codec makes is one point, however many
    limits it stands for."""
    pairs = [(r.bpp, getattr(r, figure)) for r in rows if (r.codec, r.image) == (codec, image)]
    return list(dict.fromkeys(known(pairs, figure)))


def against_cool_chic(rows: Sequence[Row], codec: str) -> tuple[float, int] | None:
    """Against the points that Cool-Chic published for each picture."""
    anchors: dict[str, Sequence[Point]] = {
        row.image: published.cool_chic().get(Path(row.image).stem, []) for row in rows
    }
    return mean_rate(anchors, rows, codec)


def against_quoted(average: Means, codec: str, other: str, column: int = 1) -> float | None:
    """Of means over pictures, against a published curve of means. None where the two average in different ways."""
    quoted = published.kodak()[other]
    if ("one rate" in quoted["averaged"]) is (ONE_QUALITY in codec):
        return None
    return bd_rate(scaled(quoted_curve(other), column), scaled(curve(average, codec), column))


def quoted_curve(other: str) -> Curve:
    """The published points of a codec."""
    return [(p["bpp"], p["psnr"], p.get("ms_ssim")) for p in published.kodak()[other]["points"]]


def means_table(average: Means) -> str:
    """A line for each codec and rate; figures that nothing has are left out."""
    columns = {name: form for name, form in (FORMATS | SEEN | COSTS).items() if any(m[name] for m in average.values())}
    qualities = any(ONE_QUALITY in codec for codec, _ in average)
    titles = ["codec", "quality" if qualities else "bpp at most", *(TITLES.get(name, name) for name in columns)]
    lines = [
        [codec, f"{aim:g}", *(number(m[name], form) for name, form in columns.items())]
        for (codec, aim), m in sorted(average.items(), key=lambda item: item[0][1])
    ]
    return table(" | ".join(titles), lines)
