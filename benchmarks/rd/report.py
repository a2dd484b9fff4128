"""Means over pictures, and differences in rate between codecs."""

from __future__ import annotations

import math
import statistics
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator, PPoly

from benchmarks import published
from benchmarks.perceptual.photographs import grouped
from benchmarks.tables import mean, standard_error


@dataclass(frozen=True)
class Row:
    """The result of one picture, codec and rate; the fields of the JSON."""

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
    effort: int | None = None  # of profile rd
    ssimulacra2: float | None = None  # None for pictures too small for it
    lpips: float | None = None  # None where networks had no weights, or were not asked; dists too
    dists: float | None = None
    butteraugli: float | None = None  # None where the judges were not asked; cvvdp too
    cvvdp: float | None = None

    @property
    def aim(self) -> float:
        """Bits per pixel at most, or the quality."""
        aim = self.quality if self.max_bpp is None else self.max_bpp
        assert aim is not None
        return aim

    @property
    def key(self) -> tuple[str, float, str]:
        """The values that identify the row."""
        return self.codec, self.aim, self.image


@dataclass(frozen=True)
class BdRate:
    """BD-rates over pictures, in percent, and the mean over pictures of the bits per pixel that they compare."""

    pictures: int
    mean: float
    standard_error: float | None  # None for one picture
    least: float
    most: float
    from_bpp: float
    to_bpp: float


Point = tuple[float, float]  # bits per pixel, PSNR or another figure
Means = dict[tuple[str, float], dict[str, float | None]]  # by codec and rate or quality, then by figure
AVIF = ("avif tune=psnr 10 bits", "avif tune=psnr")  # for the highest PSNR, the better one first
ONE_QUALITY = "one quality"  # in the name of a codec whose pictures have one quality, and not one rate
SEEN = {"ssimulacra2": ".1f", "lpips": ".3f", "dists": ".3f"}
JUDGED = {"ms_ssim": ".4f", "butteraugli": ".2f", "cvvdp": ".2f"}  # which chose nothing in the codec
QUALITIES = ("psnr", *SEEN, *JUDGED)
LESS_IS_BETTER = ("lpips", "dists", "butteraugli")
FIGURES = ("bytes", "bpp", *QUALITIES, "gaussians", "encode_s", "decode_ms")
TITLES = {
    "images": "pictures",
    "psnr": "PSNR",
    "ms_ssim": "MS-SSIM",
    "ssimulacra2": "SSIMULACRA 2",
    "lpips": "LPIPS",
    "dists": "DISTS",
    "butteraugli": "Butteraugli",
    "cvvdp": "ColorVideoVDP",
    "gaussians": "Gaussians",
    "encode_s": "encode s",
    "decode_ms": "decode ms",
}


def bd_rate(anchor: Sequence[Point], test: Sequence[Point]) -> float | None:
    """Bjontegaard's difference in rate, in percent: how much more test needs than anchor; negative if it needs less.

    The mean over the qualities that both reach of the difference in log rate, each curve interpolated by piecewise
    cubic Hermite polynomials. None where they share no quality, or a curve has one point or falls.
    """
    gap = _mean_gap(*([(db, math.log10(rate)) for rate, db in sorted(points)] for points in (anchor, test)))
    return None if gap is None else 100 * (10**gap - 1)


def shared(anchor: Sequence[Point], test: Sequence[Point]) -> tuple[float, float]:
    """The least and the greatest figure that both curves reach."""
    ends = [(min(values), max(values)) for values in ([value for _, value in points] for points in (anchor, test))]
    return max(low for low, _ in ends), min(high for _, high in ends)


def compared(anchor: Sequence[Point], test: Sequence[Point]) -> tuple[float, float]:
    """The lowest and the highest rate of either curve in the range of quality that both reach."""
    ends = shared(anchor, test)
    rates = [np.interp(ends, *np.array(sorted((db, bpp) for bpp, db in points)).T) for points in (anchor, test)]
    return float(min(low for low, _ in rates)), float(max(high for _, high in rates))


def bd_psnr(anchor: Sequence[Point], test: Sequence[Point]) -> float | None:
    """Bjontegaard's difference in quality: dB by which test is better, averaged over the log rates that both reach."""
    return _mean_gap(*([(math.log10(rate), db) for rate, db in sorted(points)] for points in (anchor, test)))


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
    """The integral of the curve through points, up to some x."""
    return PchipInterpolator(*np.array(points).T).antiderivative()


def means(rows: Sequence[Row]) -> Means:
    """For each codec and rate the mean of every figure over the pictures; None where a picture has none. images: how
    many they are; above: how many take more than was allowed."""
    groups = defaultdict(list)
    for row in rows:
        groups[row.codec, row.aim].append(row)
    result: Means = {}
    for key, group in groups.items():
        result[key] = {name: mean([getattr(row, name) for row in group]) for name in FIGURES}
        result[key]["images"] = len(group)
        result[key]["above"] = sum(row.max_bpp is not None and row.bpp > row.max_bpp for row in group)
    return result


def curve(average: Means, codec: str, figure: str = "psnr") -> list[Point]:
    """The mean bits per pixel and PSNR, or another figure, of a codec at each rate that has both."""
    found = [(m["bpp"], m[figure]) for (name, _), m in average.items() if name == codec]
    return [(bpp, value) for bpp, value in found if bpp is not None and value is not None]


def against(rows: Sequence[Row], codec: str, anchor: str) -> BdRate | None:
    """The BD-rates of a codec. None where a picture that both have has no such rate."""
    images = dict.fromkeys(row.image for row in rows if row.codec == anchor)
    return _over_pictures({image: points(rows, anchor, image) for image in images}, rows, codec)


def against_cool_chic(rows: Sequence[Row], codec: str) -> BdRate | None:
    """Like against(), for the points that Cool-Chic published for each picture."""
    images = dict.fromkeys(row.image for row in rows)
    return _over_pictures({image: published.cool_chic().get(Path(image).stem, []) for image in images}, rows, codec)


def _over_pictures(anchors: dict[str, list[Point]], rows: Sequence[Row], codec: str) -> BdRate | None:
    """BD-rates against points by picture."""
    images = [i for i in dict.fromkeys(row.image for row in rows if row.codec == codec) if i in anchors]
    curves = [(anchors[image], points(rows, codec, image)) for image in images]
    rates = [rate for pair in curves if (rate := bd_rate(*pair)) is not None]
    if not rates or len(rates) < len(curves):
        return None
    low, high = (statistics.fmean(ends) for ends in zip(*(compared(*pair) for pair in curves), strict=True))
    error = standard_error(rates, grouped(images))
    return BdRate(len(rates), statistics.fmean(rates), error, min(rates), max(rates), low, high)


def points(rows: Sequence[Row], codec: str, image: str) -> list[Point]:
    """Bits per pixel and PSNR of one picture; the smallest file that a codec makes is one point, however many limits
    it stands for."""
    mine = [row for row in rows if (row.codec, row.image) == (codec, image)]
    return list(dict.fromkeys((row.bpp, row.psnr) for row in mine if row.psnr is not None))


def against_quoted(average: Means, codec: str, other: str) -> BdRate | None:
    """The BD-rate of means over pictures against a published curve of means: as of one picture. None where the two
    average in different ways."""
    quoted = published.kodak()[other]
    if ("one rate" in quoted["averaged"]) is (ONE_QUALITY in codec):
        return None
    pair = [(p["bpp"], p["psnr"]) for p in quoted["points"]], curve(average, codec)
    rate = bd_rate(*pair)
    return None if rate is None else BdRate(1, rate, None, rate, rate, *compared(*pair))


def bd_rates(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Every BD-rate against AVIF."""
    codecs = dict.fromkeys(row.codec for row in rows)
    pairs = [(codec, anchor) for anchor in AVIF if anchor in codecs for codec in codecs if codec != anchor]
    found = [(pair, against(rows, *pair)) for pair in pairs]
    return [{"codec": pair[0], "anchor": pair[1], **asdict(rate)} for pair, rate in found if rate]
