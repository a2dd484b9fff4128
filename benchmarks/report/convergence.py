"""Error against run time."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.report.plots import style
from benchmarks.report.section import Content, Draw, Section, number, table

WITHIN_DB = (1.0, 0.5, 0.1)
Curve = list[tuple[float, float]]  # seconds, dB
NAMES = {
    "rd": "rd, tuned for PSNR",
    "rd visual": "rd, tuned for the eye",
    "avif": "avif, tune=psnr",
    "avif visual": "avif, tune=iq",
}
UNITS = {"avif": "speed", "avif visual": "speed", "webp": "method", "jpegxl": "effort"}
FITTED_WITH_MORE = ("rd", "rd visual", "paper", "baseline")  # bytes on their way than in their file
# Complete encodes that make a curve: their method, and what its settings have.
COMPLETE = {
    "rd, time limits": ("rd", " s"),
    "rd, efforts": ("rd", "effort"),
    "rd, tuned for the eye, efforts": ("rd visual", "effort"),
}


def section(*measured: Content | None) -> Section:
    """From kodak.json, with the plot, and mosaics.json."""
    contents = [content for content in measured if content]
    rows = [row for content in contents for row in content["rows"]]
    settings = contents[0]["settings"]
    tables = []
    for megapixels in sorted({row["megapixels"] for row in rows}):
        mine = [row for row in rows if row["megapixels"] == megapixels]
        tables.append(f"### {megapixels:g} megapixels\n\n{curves_table(mine)}")
        if points := points_table(mine):
            tables.append(points)
    smallest = min(row["megapixels"] for row in rows)
    first = [row for row in rows if row["megapixels"] == smallest]
    said = (
        f"How fast does the error fall, at {settings['bpp']:g} bpp on the same cores and clock? At "
        f"{smallest:g} megapixels, which the plot shows: {result(first)} All but rd had "
        f"{settings['seconds']:g} s at most. Pictures of one folder and one rate say nothing on others, "
        "plain Adam makes no file, and networks are fitted by torch without kernels of their own. On its way a fit "
        "may have more bytes than its file, which it gives up at its end: the plot has complete files of rd alone. "
        "Each time is that of one encode, which may be a third longer in another hour. Other codecs' are without the "
        "search for the quality that fits. Pictures larger than the folder's are mosaics of the same ones."
    )
    panels: list[Draw] = [lambda axes: draw_psnr(axes, first)]
    if all(row["lpips"] is not None for row in first):
        panels.append(lambda axes: draw_lpips(axes, first))
    return Section("convergence", "Error against run time", said, tables, contents, panels)


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
    """Of each method and picture. The complete encodes of rd under time limits make one curve of each picture, its
    efforts another, and those tuned for the eye a third."""
    found = [(r["method"], [(t, db) for t, db in r["curve"]]) for r in rows if r["curve"] and not r["setting"]]
    for picture in dict.fromkeys(row["picture"] for row in rows):
        for name in COMPLETE:
            mine = [row for row in files_of(rows, name) if row["picture"] == picture]
            if len(mine) > 1:
                found.append((name, sorted((row["seconds"], row["psnr"]) for row in mine)))
    return found


def files_of(rows: Sequence[dict[str, Any]], name: str) -> list[dict[str, Any]]:
    """Complete encodes that make one of COMPLETE; that with nothing set is in each."""
    method, word = COMPLETE[name]
    return [row for row in rows if row["method"] == method and (not row["setting"] or word in row["setting"])]


def name_of(method: str) -> str:
    """As a reader sees it."""
    return NAMES.get(method, method)


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
        own = slowest(files_of(rows, method)) if method in COMPLETE else at_rest(rows, method)
        sizes = [row["bytes"] for row in own if row["bytes"]]
        lpips = [row["lpips"] for row in own if row["lpips"] is not None]
        times = [statistics.fmean(until(curve, db) for curve in mine) for db in WITHIN_DB]
        lines.append(
            [
                name_of(method),
                len(mine),
                f"{statistics.fmean(sizes):,.0f}" if sizes else "no file",
                f"{statistics.fmean(curve[-1][1] for curve in mine):.2f}",
                number(statistics.fmean(lpips) if lpips else None, ".3f"),
                f"{statistics.fmean(curve[-1][0] for curve in mine):.2f}",
                *(f"{seconds:.2f}" for seconds in times),
                "-" if method in FITTED_WITH_MORE else f"{statistics.fmean(map(bought, mine)):.2f}",
            ]
        )
    titles = (
        "method | pictures | bytes | PSNR at the end | LPIPS | seconds | within 1 dB of it after | 0.5 dB | 0.1 dB | "
    )
    return table(f"{titles}dB bought by the second half of the time", lines)


def at_rest(rows: Sequence[dict[str, Any]], method: str) -> list[dict[str, Any]]:
    """Of each picture what a method made with nothing set."""
    return [row for row in rows if row["method"] == method and not row["setting"]]


def slowest(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Of each picture the file that took longest."""
    pictures = dict.fromkeys(row["picture"] for row in rows)
    return [max((r for r in rows if r["picture"] == name), key=lambda row: row["seconds"]) for name in pictures]


def points_table(rows: Sequence[dict[str, Any]]) -> str:
    """The other codecs, whose encodes have no curve."""
    lines = []
    for method, setting in dict.fromkeys((r["method"], r["setting"]) for r in rows if r["curve"] is None):
        mine = [row for row in rows if (row["method"], row["setting"], row["curve"]) == (method, setting, None)]
        lpips = [row["lpips"] for row in mine if row["lpips"] is not None]
        unit = f"{UNITS[method]} {setting}" if method in UNITS else "-"
        size, db, seconds = (statistics.fmean(row[name] for row in mine) for name in ("bytes", "psnr", "seconds"))
        perceived = number(statistics.fmean(lpips) if lpips else None, ".3f")
        lines.append([name_of(method), unit, len(mine), f"{size:,.0f}", f"{db:.2f}", perceived, f"{seconds:.3f}"])
    note = "\n\nWhere bytes are above those of rd, a codec makes no file so small of some picture."
    return table("codec | setting | pictures | bytes | PSNR | LPIPS | seconds", lines) + note if lines else ""


def methods(rows: Sequence[dict[str, Any]]) -> tuple[list[str], list[str]]:
    """Those with a line, and those whose settings are marks. On its way a fit of rd has more bytes than its file, so
    that its complete files stand for it where there are some."""
    names = list(dict.fromkeys(name for name, _ in curves(rows)))
    replaced = {COMPLETE[name][0] for name in names if name in COMPLETE}
    with_line = [name for name in names if name not in replaced]
    return with_line, list(dict.fromkeys(row["method"] for row in rows if row["curve"] is None))


def draw_psnr(axes: Any, rows: Sequence[dict[str, Any]]) -> None:
    """Means over the pictures, at the times at which every picture of a method has an error; other codecs as marks."""
    with_line, others = methods(rows)
    found = curves(rows)
    lowest = math.inf
    for k, method in enumerate(with_line):
        if method in COMPLETE:
            axes.plot(*zip(*ends(files_of(rows, method)), strict=True), **style(k), label=name_of(method))
            continue
        times, levels = mean_curve([curve for name, curve in found if name == method])
        axes.plot(times, levels, **style(k) | {"marker": ""}, label=name_of(method))
        lowest = min(lowest, levels[-1])
    for k, method in enumerate(others, len(with_line)):
        points = ends([row for row in rows if row["method"] == method])
        axes.plot(*zip(*points, strict=True), **mark(k), label=name_of(method))
        lowest = min(lowest, points[0][1])
    axes.set(xscale="log", xlabel="seconds", ylabel="PSNR, dB", ylim=(math.floor(lowest) - 2, None))


def draw_lpips(axes: Any, rows: Sequence[dict[str, Any]]) -> None:
    """Of complete files, and of what the others had at their end, the best at the top as in the other panel."""
    with_line, others = methods(rows)
    for k, method in enumerate(with_line):
        mine = files_of(rows, method) if method in COMPLETE else [r for r in rows if r["method"] == method]
        points = ends(mine, "lpips")
        axes.plot(*zip(*points, strict=True), **style(k), label=name_of(method))
        if len(points) == 1:
            axes.annotate(f"{method}  ", points[0], ha="right", va="center", fontsize=7)
    for k, method in enumerate(others, len(with_line)):
        points = ends([row for row in rows if row["method"] == method], "lpips")
        axes.plot(*zip(*points, strict=True), **mark(k), label=name_of(method))
    axes.set(xscale="log", xlabel="seconds", ylabel="LPIPS, better upwards")
    axes.invert_yaxis()


def mark(k: int) -> dict[str, Any]:
    """Of the k-th thing shown, if its settings are marks."""
    return style(k) | {"linestyle": "none", "fillstyle": "none"}


def ends(rows: Sequence[dict[str, Any]], figure: str = "psnr") -> list[tuple[float, float]]:
    """For each setting the seconds that an encode took and what came of it, means over the pictures."""
    groups = [[row for row in rows if row["setting"] == name] for name in dict.fromkeys(row["setting"] for row in rows)]
    return sorted(
        (statistics.fmean(row["seconds"] for row in group), statistics.fmean(row[figure] for row in group))
        for group in groups
    )


def mean_curve(curves: Sequence[Curve]) -> tuple[list[float], list[float]]:
    """Times, and at each the mean of the errors last seen by then."""
    times = sorted({seconds for curve in curves for seconds, _ in curve})
    times = [seconds for seconds in times if seconds >= max(curve[0][0] for curve in curves)]
    levels = []
    for seconds in times:
        seen = [np.searchsorted([t for t, _ in curve], seconds, side="right") - 1 for curve in curves]
        levels.append(statistics.fmean(curve[k][1] for k, curve in zip(seen, curves, strict=True)))
    return times, levels
