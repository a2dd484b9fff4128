"""Error against run time."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from itertools import cycle
from typing import Any

import numpy as np

from benchmarks.report.section import Content, Section, number, table

WITHIN_DB = (1.0, 0.5, 0.1)
Curve = list[tuple[float, float]]  # seconds, dB
UNITS = {"avif": "speed", "webp": "method", "jpegxl": "effort"}
COMPLETE = {"rd, time limits": " s", "rd, efforts": "effort"}  # and what their settings have


def section(content: Content) -> Section:
    """From convergence.json."""
    rows = content["rows"]
    tables = []
    for megapixels in sorted({row["megapixels"] for row in rows}):
        mine = [row for row in rows if row["megapixels"] == megapixels]
        tables.append(f"### {megapixels:g} megapixels\n\n{curves_table(mine)}")
        if points := points_table(mine):
            tables.append(points)
    smallest = min(row["megapixels"] for row in rows)
    first = [row for row in rows if row["megapixels"] == smallest]
    said = (
        f"How fast does the error fall, at {content['settings']['bpp']:g} bpp on the same cores and clock? "
        f"{result(first)} Pictures of one folder and one rate say nothing on others, plain Adam makes no file, and "
        "networks are fitted by torch without kernels of their own. On its way a fit may have more bytes than its "
        "file, which it gives up at its end: the plot has complete files of rd alone."
    )
    return Section(
        "convergence", "Error against run time", said, tables, [content], draw=lambda axes: draw(axes, first)
    )


def result(rows: Sequence[dict[str, Any]]) -> str:
    """What came out, in one sentence."""
    found = []
    for method in ("rd", "paper", "baseline", "plain Adam", "siren", "hash grid"):
        mine = [curve for name, curve in curves(rows) if name == method]
        if mine:
            db, seconds = (statistics.fmean(curve[-1][k] for curve in mine) for k in (1, 0))
            found.append(f"{method} {db:.2f} dB after {seconds:.1f} s")
    return f"{', '.join(found)}." if found else ""


def curves(rows: Sequence[dict[str, Any]]) -> list[tuple[str, Curve]]:
    """Of each method and picture. The complete encodes of rd under time limits make one curve of each picture, and its
    efforts another."""
    found = [(r["method"], [(t, db) for t, db in r["curve"]]) for r in rows if r["curve"] and not r["setting"]]
    for picture in dict.fromkeys(row["picture"] for row in rows):
        for name in COMPLETE:
            mine = [row for row in files_of(rows, name) if row["picture"] == picture]
            if len(mine) > 1:
                found.append((name, sorted((row["seconds"], row["psnr"]) for row in mine)))
    return found


def files_of(rows: Sequence[dict[str, Any]], name: str) -> list[dict[str, Any]]:
    """Complete encodes of rd that make one of COMPLETE; that with nothing set is in each."""
    return [row for row in rows if row["method"] == "rd" and (not row["setting"] or COMPLETE[name] in row["setting"])]


def until(curve: Curve, db: float) -> float:
    """Seconds after which the error stays within so many dB of that at the end."""
    last = 0.0
    for (_, value), (following, _) in zip(curve, [*curve[1:], curve[-1]], strict=True):
        if abs(value - curve[-1][1]) > db:
            last = following
    return last or curve[0][0]


def bought(curve: Curve) -> float:
    """dB that the second half of the time bought."""
    before = [db for seconds, db in curve if seconds <= curve[-1][0] / 2]
    return curve[-1][1] - (max(before) if before else curve[0][1])


def curves_table(rows: Sequence[dict[str, Any]]) -> str:
    """Means over the pictures for each method that has a curve."""
    lines = []
    found = curves(rows)
    for method in dict.fromkeys(name for name, _ in found):
        mine = [curve for name, curve in found if name == method]
        own = [row for row in rows if row["method"] == method and not row["setting"]]
        sizes = [row["bytes"] for row in own if row["bytes"]]
        lpips = [row["lpips"] for row in own if row["lpips"] is not None]
        times = [statistics.fmean(until(curve, db) for curve in mine) for db in WITHIN_DB]
        lines.append(
            [
                method,
                len(mine),
                f"{statistics.fmean(sizes):,.0f}" if sizes else "no file" if own else "-",
                f"{statistics.fmean(curve[-1][1] for curve in mine):.2f}",
                number(statistics.fmean(lpips) if lpips else None, ".3f"),
                f"{statistics.fmean(curve[-1][0] for curve in mine):.2f}",
                *(f"{seconds:.2f}" for seconds in times),
                f"{statistics.fmean(map(bought, mine)):.2f}",
            ]
        )
    titles = (
        "method | pictures | bytes | PSNR at the end | LPIPS | seconds | within 1 dB of it after | 0.5 dB | 0.1 dB | "
    )
    return table(f"{titles}dB bought by the second half of the time", lines)


def points_table(rows: Sequence[dict[str, Any]]) -> str:
    """The other codecs, whose encodes have no curve."""
    lines = []
    for method, setting in dict.fromkeys((r["method"], r["setting"]) for r in rows if r["curve"] is None):
        mine = [row for row in rows if (row["method"], row["setting"], row["curve"]) == (method, setting, None)]
        lpips = [row["lpips"] for row in mine if row["lpips"] is not None]
        unit = f"{UNITS[method]} {setting}" if method in UNITS else "-"
        size, db, seconds = (statistics.fmean(row[name] for row in mine) for name in ("bytes", "psnr", "seconds"))
        perceived = number(statistics.fmean(lpips) if lpips else None, ".3f")
        lines.append([method, unit, len(mine), f"{size:,.0f}", f"{db:.2f}", perceived, f"{seconds:.3f}"])
    return table("codec | setting | pictures | bytes | PSNR | LPIPS | seconds", lines) if lines else ""


def draw(axes: Any, rows: Sequence[dict[str, Any]]) -> None:
    """Means over the pictures, at the times at which every picture of a method has an error; other codecs as marks."""
    styles = cycle(["-", "--", "-.", ":", (0, (6, 1, 1, 1)), (0, (1, 3)), (0, (8, 3))])
    marks = cycle("os^Dvx")
    found = curves(rows)
    lowest = math.inf
    names = dict.fromkeys(name for name, _ in found)
    for method in names:
        if method == "rd" and not names.keys().isdisjoint(COMPLETE):
            continue  # on its way a fit has more bytes than its file, so that complete files alone compare
        whole = method in COMPLETE
        mine = [curve for name, curve in found if name == method]
        times, levels = complete(files_of(rows, method)) if whole else mean_curve(mine)
        axes.plot(times, levels, linestyle=next(styles), marker="." if whole else "", label=method)
        lowest = min(lowest, levels[-1])
    for method in dict.fromkeys(row["method"] for row in rows if row["curve"] is None):
        own = [row for row in rows if row["method"] == method]
        settings = dict.fromkeys(row["setting"] for row in own)
        ends = [[(r["seconds"], r["psnr"]) for r in own if r["setting"] == setting] for setting in settings]
        means = sorted((statistics.fmean(t for t, _ in end), statistics.fmean(db for _, db in end)) for end in ends)
        axes.plot(*zip(*means, strict=True), linestyle="none", marker=next(marks), fillstyle="none", label=method)
        lowest = min(lowest, means[0][1])
    axes.set(xscale="log", xlabel="seconds", ylabel="PSNR, dB", ylim=(math.floor(lowest) - 2, None))


def complete(rows: Sequence[dict[str, Any]]) -> tuple[list[float], list[float]]:
    """Means over the pictures of files, for each setting."""
    groups = [[row for row in rows if row["setting"] == name] for name in dict.fromkeys(row["setting"] for row in rows)]
    means = sorted(
        tuple(statistics.fmean(row[what] for row in group) for what in ("seconds", "psnr")) for group in groups
    )
    return [seconds for seconds, _ in means], [db for _, db in means]


def mean_curve(curves: Sequence[Curve]) -> tuple[list[float], list[float]]:
    """Times, and at each the mean of the errors last seen by then."""
    times = sorted({seconds for curve in curves for seconds, _ in curve})
    times = [seconds for seconds in times if seconds >= max(curve[0][0] for curve in curves)]
    levels = []
    for seconds in times:
        seen = [np.searchsorted([t for t, _ in curve], seconds, side="right") - 1 for curve in curves]
        levels.append(statistics.fmean(curve[k][1] for k, curve in zip(seen, curves, strict=True)))
    return times, levels
