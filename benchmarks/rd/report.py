"""The report: means over the pictures, differences in rate, and a row for each picture."""

from __future__ import annotations

import math
import statistics
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from benchmarks import published


@dataclass(frozen=True)
class Row:
    """One picture through one codec at one rate; the fields of the JSON."""

    codec: str
    max_bpp: float
    image: str
    bytes: int
    bpp: float
    psnr: float | None  # None for identical pixels
    ms_ssim: float | None  # None for pictures too small for it
    gaussians: int | None
    encode_s: float
    decode_ms: float

    @property
    def key(self) -> tuple[str, float, str]:
        """What makes a row one of its own."""
        return self.codec, self.max_bpp, self.image


Point = tuple[float, float]  # bits per pixel, quality
Curve = Sequence[tuple[float | None, ...]]  # bits per pixel, PSNR, MS-SSIM
Means = dict[tuple[str, float], dict[str, float | None]]  # by codec and rate, then by figure


def bd_rate(anchor: Sequence[Point], test: Sequence[Point]) -> float | None:
    """Bjontegaard's difference in rate, in percent: what test needs more (or, below 0, less) than anchor.

    The mean over the qualities that both reach of the difference in log rate, each curve interpolated by piecewise
    cubic Hermite polynomials. None where they share no quality, or a curve has one point or falls.
    """
    gap = _mean_gap(*([(quality, math.log10(rate)) for rate, quality in sorted(points)] for points in (anchor, test)))
    return None if gap is None else 100 * (10**gap - 1)


def bd_quality(anchor: Sequence[Point], test: Sequence[Point]) -> float | None:
    """The same the other way: how much better test is, over the log rates that both reach. Of PSNR, it is BD-PSNR."""
    return _mean_gap(*([(math.log10(rate), quality) for rate, quality in sorted(points)] for points in (anchor, test)))


def _mean_gap(anchor: Sequence[Point], test: Sequence[Point]) -> float | None:
    """The mean of test less anchor over the x that both reach."""
    curves = []
    for points in (anchor, test):
        if len(points) < 2 or (np.diff([x for x, _ in points]) <= 0).any():
            return None
        curves.append(PchipInterpolator(*np.array(points).T))
    low, high = (f(c.x[end] for c in curves) for f, end in ((max, 0), (min, -1)))
    if low >= high:
        return None
    ours, theirs = (c.integrate(low, high) / (high - low) for c in reversed(curves))
    return float(ours - theirs)


def means(rows: Sequence[Row]) -> Means:
    """For each codec and rate the mean of every figure over the pictures; None where a picture has none."""
    groups = defaultdict(list)
    for row in rows:
        groups[row.codec, row.max_bpp].append(row)
    figures = ("bytes", "bpp", "psnr", "ms_ssim", "gaussians", "encode_s", "decode_ms")
    result = {}
    for key, group in groups.items():
        columns = {f: [getattr(row, f) for row in group] for f in figures}
        result[key] = {f: None if None in values else statistics.fmean(values) for f, values in columns.items()}
        result[key]["images"] = len(group)
    return result


def curve(average: Means, codec: str) -> Curve:
    """The mean points of a codec."""
    return [(m["bpp"], m["psnr"], m["ms_ssim"]) for (name, _), m in average.items() if name == codec]


def scaled(points: Curve, column: int) -> list[Point]:
    """(bits per pixel, quality) of a column; MS-SSIM in decibels, as its last digits are what differs."""
    known = [
        (rate, value) for rate, value in ((p[0], p[column]) for p in points) if rate is not None and value is not None
    ]
    return known if column == 1 else [(rate, -10 * math.log10(1 - value)) for rate, value in known if value < 1]


def anchors(rows: Sequence[Row], average: Means) -> dict[str, Curve]:
    """What rates are compared with: profile baseline of this run, and on the Kodak pictures what was published."""
    found: dict[str, Curve] = {}
    if any(row.codec == "baseline" for row in rows):
        found["baseline, measured"] = curve(average, "baseline")
    if {Path(row.image).stem for row in rows} == {f"kodim{i:02}" for i in range(1, 25)}:
        points = published.kodak()["GaussianImage"]["points"]
        found["GaussianImage, quoted"] = [(p["bpp"], p["psnr"], p["ms_ssim"]) for p in points]
    return found


def report(rows: Sequence[Row]) -> str:
    """Markdown: means, differences in rate from the published baseline, then every picture."""
    average = means(rows)
    titles = "| bpp at most | images | bytes | bpp | PSNR | MS-SSIM | Gaussians | encode s | decode ms |"
    rule = "|---" * 10 + "|"
    lines = ["| codec " + titles, rule]
    lines += [f"| {codec} | {limit:g} | {m['images']:g} | {_cells(m)}" for (codec, limit), m in average.items()]
    lines += ["", "| codec | rate against | BD-rate, PSNR | BD-rate, MS-SSIM |", "|---" * 4 + "|"]
    for name, anchor in anchors(rows, average).items():
        for codec in dict.fromkeys(codec for codec, _ in average if not name.startswith(f"{codec},")):
            rates = [bd_rate(*(scaled(p, column) for p in (anchor, curve(average, codec)))) for column in (1, 2)]
            cells = ["-" if rate is None else f"{rate:+.1f} %" for rate in rates]
            lines.append(f"| {codec} | {name} | {cells[0]} | {cells[1]} |")
    lines += ["", "| codec " + titles.replace("images", "image"), rule]
    lines += [f"| {r.codec} | {r.max_bpp:g} | {r.image} | {_cells(asdict(r))}" for r in rows]
    return "\n".join(lines)


def _cells(figures: dict[str, float | None]) -> str:
    formats = {"bytes": ".0f", "bpp": ".4f", "psnr": ".2f", "ms_ssim": ".4f", "gaussians": ".0f"}
    formats |= {"encode_s": ".2f", "decode_ms": ".2f"}
    cells = ["-" if figures[name] is None else format(figures[name], form) for name, form in formats.items()]
    return " | ".join(cells) + " |"
