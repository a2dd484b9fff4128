"""Error against run time."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
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
UNITS = {"avif": "speed", "avif visual": "speed", "jpegxl": "effort", "webp": "method", "jpeg2000": "", "jpeg": ""}
LOOKS_S = (0.1, 0.25, 0.5, 1, 2, 5, 10, 30, 60, 120)  # after which is told what each method has
# Complete encodes that make a curve: their method, and what its settings have.
COMPLETE = {
    "rd, time limits": ("rd", " s"),
    "rd, efforts": ("rd", "effort"),
    "rd, tuned for the eye, efforts": ("rd visual", "effort"),
    "paper, time limits": ("paper", " s"),
    "baseline, time limits": ("baseline", " s"),
}
VISUAL = "rd visual"
OURS = ("rd", VISUAL, "paper", "baseline")
NETWORKS = ("siren", "hash grid")
WORSE_DB = 0.1
DEFAULT = "effort 5"  # of rd with nothing set
# In every plot, so that a method looks the same in each.
DRAWN = (
    *("paper, time limits", "baseline, time limits", "plain Adam", "siren", "hash grid"),
    *("rd, time limits", "rd, efforts", "rd, tuned for the eye, efforts"),
    *("jpeg", "jpeg2000", "webp", "avif", "jpegxl", "avif visual"),
)
BETTER = {"psnr": max, "lpips": min}
NOTES_ON_BOUGHT = {
    "psnr": (
        "PSNR that a method has after so many seconds, and in brackets the dB that each second since the column before "
        "bought. Of rd, paper, baseline and other codecs the best complete file by then, of all settings; of the "
        "others what the fit has, which may be worse than before. A dash: on some picture there is none yet. An empty "
        "cell: the method had ended before."
    ),
    "lpips": "LPIPS, of which less is better, in the same way; where it was looked at seldom, between two looks.",
}


def whole(content: Content | None) -> Section:
    """From kodak.json: photographs as they are."""
    assert content
    note = (
        "Pictures of one folder and one rate say nothing on others, plain Adam makes no file, and networks are fitted "
        "by torch without kernels of their own."
    )
    return section("convergence", "Error against run time", [content], note)


def large(*contents: Content | None) -> Section:
    """From 2-megapixels.json and 12-megapixels.json, as far as there are."""
    note = (
        "Pictures larger than the folder's are mosaics of the same ones, so that those of 12 megapixels differ little, "
        "and there are fewer settings than at 0.4 megapixels: the next section has those of other codecs."
    )
    return section("convergence_large", "Error against run time of larger pictures", list(filter(None, contents)), note)


def codecs(content: Content | None) -> Section:
    """From codecs.json: other codecs on larger pictures, at each setting that was measured."""
    assert content
    note = "Pictures are mosaics of photographs, and a codec that is built in another way may be quicker."
    return section("convergence_codecs", "Other codecs on larger pictures, at each of their settings", [content], note)


def section(name: str, title: str, contents: Sequence[Content], note: str) -> Section:
    """Tables of every size, and a plot of the largest. contents: with the same settings."""
    rows, settings = [row for content in contents for row in content["rows"]], contents[0]["settings"]
    is_of_fits = any(row["method"] not in ("rd", VISUAL, *UNITS) for row in rows)
    tables = []
    sizes = sorted({row["megapixels"] for row in rows})
    for megapixels in sizes:
        mine = [row for row in rows if row["megapixels"] == megapixels]
        bought = [bought_table(mine, figure) for figure in BETTER if has(mine, figure)]
        tables += [f"### {megapixels:g} megapixels", *bought]
        tables += [curves_table(mine)] if is_of_fits else []
        tables.append(points_table(mine, f"{settings['seconds']:g} s at most"))
    by_size = {size: [row for row in rows if row["megapixels"] == size] for size in sizes}
    shown = by_size[sizes[-1]]
    pictures = list(dict.fromkeys(row["picture"] for row in shown))
    came = f"At {sizes[-1]:g} megapixels, which the plot shows: {result(shown)} " if is_of_fits else ""
    came += " ".join((soonest if is_of_fits else best_of_others)(size, by_size[size]) for size in sizes)
    said = f"How fast does the error fall, at {settings['bpp']:g} bpp on the same cores and clock? {came} {note}"
    panels: list[Draw] = [partial(draw, rows=shown, figure=figure) for figure in BETTER if has(shown, figure)]
    of = f"{sizes[-1]:g} megapixels, {settings['bpp']:g} bpp, means of {len(pictures)} pictures"
    return Section(name, title, said, tables, contents, panels, of, how(rows, settings["seconds"]))


def how(rows: Sequence[dict[str, Any]], most_s: float) -> str:
    """Of the methods that there are, what all sizes have in common."""
    names = {row["method"] for row in rows}
    told = [f"pictures are {', '.join(dict.fromkeys(row['picture'] for row in rows))}."]
    if names - {"rd", VISUAL, *UNITS}:
        told.append(f"All but rd and other codecs had {most_s:g} s at most.")
    if names & {"paper", "baseline"}:
        told.append(
            "On its way a fit has more bytes than its file, or numbers that are not rounded, and gives that up at its "
            "end: of rd, paper and baseline there are complete files alone, each of an encode of its own."
        )
    told += filter(None, [worse_for_more(rows)])
    told.append("Each time is that of one encode, which may be a third longer in another hour.")
    if names & {*UNITS}:
        told.append("Other codecs' are without the search for the quality that fits.")
    fitted = [row for row in rows if row["method"] in NETWORKS and row["lpips"] is not None]
    for megapixels in sorted({row["megapixels"] for row in fitted if not row.get("lpips_curve")}):
        told.append(f"Networks of {megapixels:g} megapixels take a minute to draw: their LPIPS is of the end alone.")
    return " ".join(told)


def worse_for_more(rows: Sequence[dict[str, Any]]) -> str:
    """How often the next effort or time limit of rd tuned for PSNR, paper and baseline made a worse file, and the worst
    of it, in a sentence; none where it never did."""
    told = []
    for name in (name for name, (method, _) in COMPLETE.items() if method != VISUAL):
        found = sorted(files_of(rows, name), key=lambda row: amount(row["setting"], name))
        steps, falls = 0, []
        for megapixels, picture in dict.fromkeys((row["megapixels"], row["picture"]) for row in found):
            mine = [row for row in found if (row["megapixels"], row["picture"]) == (megapixels, picture)]
            for less, more in pairwise(mine):
                steps += 1
                settings = " to ".join(row["setting"] or "nothing set" for row in (less, more))
                falls.append((less["psnr"] - more["psnr"], f"{picture}, {megapixels:g} megapixels, {settings}"))
        falls = [one for one in falls if one[0] > WORSE_DB]
        if falls:
            fall, where = max(falls)
            told.append(f"{name}, {len(falls)} of {steps} times, by {fall:.2f} dB at most ({where})")
    return f"More time or effort made a file worse by more than {WORSE_DB:g} dB: {'; '.join(told)}." if told else ""


def amount(setting: str, name: str) -> float:
    """What a setting of one of COMPLETE allows: seconds or an effort. Nothing set is effort 5, or no limit."""
    if not setting:
        return 5 if "efforts" in name else math.inf
    return float(setting.removeprefix("effort ").removesuffix(" s"))


def result(rows: Sequence[dict[str, Any]]) -> str:
    """What came out, in one sentence."""
    found = []
    for method in ("rd", "paper", "baseline", "plain Adam", *NETWORKS):
        mine = at_rest(rows, method)
        if mine:
            db, seconds = (statistics.fmean(row[name] for row in mine) for name in ("psnr", "seconds"))
            found.append(f"{method} {db:.2f} dB after {seconds:.1f} s")
    return f"{', '.join(found)}." if found else ""


def soonest(megapixels: float, rows: Sequence[dict[str, Any]]) -> str:
    """The fastest that rd offers, beside AVIF of about that time, in a sentence; none where one was not measured."""
    told = []
    for method, setting in (("rd", "effort 1"), ("avif", "6")):
        mine = [row for row in rows if (row["method"], row["setting"]) == (method, setting)]
        if not mine:
            return ""
        db, seconds = (statistics.fmean(row[name] for row in mine) for name in ("psnr", "seconds"))
        told.append(f"{db:.2f} dB after {seconds:.2f} s")
    ours, avif = told
    return f"Whoever is in a hurry at {megapixels:g} megapixels has {ours} by rd's effort 1, {avif} by AVIF's speed 6."


def best_of_others(megapixels: float, rows: Sequence[dict[str, Any]]) -> str:
    """Of other codecs at any setting, beside rd with nothing set, in a sentence; none where one was not measured."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["method"], row["setting"]), []).append(row)
    others = [key for key in groups if key[0] in UNITS]
    told = []
    for figure, method, form in (("psnr", "rd", "{:.2f} dB"), ("lpips", VISUAL, "LPIPS {:.3f}")):
        if has(rows, figure) and (method, "") in groups and others:
            values = {key: statistics.fmean(row[figure] for row in mine) for key, mine in groups.items()}
            best = BETTER[figure](others, key=values.__getitem__)
            ours, theirs = (
                f"{form.format(values[key])} after {statistics.fmean(row['seconds'] for row in groups[key]):.1f} s"
                for key in ((method, ""), best)
            )
            of = " ".join(filter(None, [name_of(best[0]), setting_of(*best)]))
            told.append(f"{name_of(method)}, has {ours}, the best of other codecs {theirs} ({of})")
    return f"At {megapixels:g} megapixels {'; '.join(told)}." if told else ""


def has(rows: Sequence[dict[str, Any]], figure: str) -> bool:
    """Whether it was measured."""
    return all(row[figure] is not None for row in rows)


def curves(rows: Sequence[dict[str, Any]], figure: str = "psnr") -> list[tuple[str, Curve]]:
    """Of each method and picture, PSNR or LPIPS. Complete encodes of one method make a curve of each picture: all under
    time limits, or all efforts."""
    name_of_curve = {"psnr": "curve", "lpips": "lpips_curve"}[figure]
    fitted = [row for row in rows if row["method"] not in OURS and row.get(name_of_curve)]
    found = [(row["method"], [(at, value) for at, value in row[name_of_curve]]) for row in fitted]
    lines = [name for name in COMPLETE if any(row["setting"] for row in files_of(rows, name))]
    for picture in dict.fromkeys(row["picture"] for row in rows):
        for name in lines or COMPLETE:
            mine = [row for row in files_of(rows, name) if row["picture"] == picture]
            if mine:
                found.append((name, sorted((row["seconds"], row[figure]) for row in mine)))
    return found


def files_of(rows: Sequence[dict[str, Any]], name: str) -> list[dict[str, Any]]:
    """Complete encodes that make one of COMPLETE; that with nothing set is in each."""
    method, word = COMPLETE[name]
    return [row for row in rows if row["method"] == method and (not row["setting"] or word in row["setting"])]


def name_of(method: str) -> str:
    """As a reader sees it."""
    return NAMES.get(method, method)


def setting_of(codec: str, setting: str) -> str:
    """Another codec's, with its unit; empty where the codec has but one."""
    return f"{UNITS[codec]} {setting}" if UNITS[codec] else ""


def until(curve: Curve, db: float) -> float:
    """Seconds after which the error stays within so many dB of that at the end."""
    last = 0.0
    for (_, value), (following, _) in zip(curve, [*curve[1:], curve[-1]], strict=True):
        if abs(value - curve[-1][1]) > db:
            last = following
    return last or curve[0][0]


def curves_table(rows: Sequence[dict[str, Any]]) -> str:
    """Means over the pictures for each method that has a line in the plot."""
    lines = []
    found = curves(rows)
    for method in methods(rows)[0]:
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
            ]
        )
    titles = "method | pictures | bytes | PSNR at the end | LPIPS | seconds | within 1 dB of it after | 0.5 dB | 0.1 dB"
    note = (
        "Where each ends. Rows of rd, paper and baseline are of complete files, the slowest one last: under time "
        "limits, or by efforts (5 where nothing is said)."
    )
    return f"{note}\n\n" + table(titles, lines)


def bought_table(rows: Sequence[dict[str, Any]], figure: str) -> str:
    """What each method has after so many seconds, PSNR or LPIPS, and of PSNR what every further second bought."""
    with_line, others = methods(rows)
    found = curves(rows, figure)
    names = {method: [curve for name, curve in found if name == method] for method in with_line}
    for method in others:
        own = [row for row in rows if row["method"] == method]
        pictures = dict.fromkeys(row["picture"] for row in own)
        names[method] = [sorted((r["seconds"], r[figure]) for r in own if r["picture"] == one) for one in pictures]
    names = {method: mine for method, mine in names.items() if mine}
    last = max((curve[-1][0] for some in names.values() for curve in some), default=0.0)
    looks = [seconds for k, seconds in enumerate(LOOKS_S) if k == 0 or LOOKS_S[k - 1] < last]
    lines = []
    for method, mine in names.items():
        is_complete = method in COMPLETE or method in others
        cells, before = [], None
        for k, seconds in enumerate(looks):
            had = [best_by(curve, seconds, figure if is_complete else None) for curve in mine]
            level = statistics.fmean(value for value in had if value is not None) if None not in had else None
            gained = ""
            if figure == "psnr" and level is not None and before is not None:
                gained = f" ({(level - before) / (seconds - looks[k - 1]):+.2f})"
            is_over = k > 0 and all(curve[-1][0] <= looks[k - 1] for curve in mine)
            cells.append("" if is_over else number(level, {"psnr": ".2f", "lpips": ".3f"}[figure]) + gained)
            before = level
        lines.append([name_of(method), *cells])
    note = NOTES_ON_BOUGHT[figure]
    return f"{note}\n\n" + table(" | ".join(["method", *(f"{seconds:g} s" for seconds in looks)]), lines)


def best_by(curve: Curve, seconds: float, figure: str | None) -> float | None:
    """The best of complete files by then, if a figure says which is best, or the error then; None where there is none
    yet."""
    seen = [value for at, value in curve if at <= seconds]
    return None if not seen else BETTER[figure](seen) if figure else value_at(curve, seconds)


def at_rest(rows: Sequence[dict[str, Any]], method: str) -> list[dict[str, Any]]:
    """Of each picture what a method made with nothing set."""
    return [row for row in rows if row["method"] == method and not row["setting"]]


def slowest(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Of each picture the file that took longest."""
    pictures = dict.fromkeys(row["picture"] for row in rows)
    return [max((r for r in rows if r["picture"] == name), key=lambda row: row["seconds"]) for name in pictures]


def points_table(rows: Sequence[dict[str, Any]], limit: str) -> str:
    """Complete files: ours at each limit and effort, and other codecs' at each setting. limit: of paper and baseline
    with nothing set."""
    lines = []
    complete = [row for row in rows if row["curve"] is None or row["method"] in OURS]
    found = sorted(complete, key=lambda row: ([*OURS, *UNITS].index(row["method"]), row["seconds"]))
    for method, setting in dict.fromkeys((row["method"], row["setting"]) for row in found):
        mine = [row for row in complete if (row["method"], row["setting"]) == (method, setting)]
        lpips = [row["lpips"] for row in mine if row["lpips"] is not None]
        if method in UNITS:
            unit = setting_of(method, setting) or "-"
        else:
            unit = setting or (DEFAULT if method.startswith("rd") else limit)
        size, db, seconds = (statistics.fmean(row[name] for row in mine) for name in ("bytes", "psnr", "seconds"))
        perceived = number(statistics.fmean(lpips) if lpips else None, ".3f")
        lines.append([name_of(method), unit, len(mine), f"{size:,.0f}", f"{db:.2f}", perceived, f"{seconds:.3f}"])
    note = "\n\nWhere bytes are above those of rd, a codec makes no file so small of some picture."
    return table("method | setting | pictures | bytes | PSNR | LPIPS | seconds", lines) + note if lines else ""


def methods(rows: Sequence[dict[str, Any]]) -> tuple[list[str], list[str]]:
    """Those with a line, and those whose settings are marks."""
    with_line = sorted({name for name, _ in curves(rows)}, key=DRAWN.index)
    return with_line, list(dict.fromkeys(row["method"] for row in rows if row["curve"] is None))


def draw(axes: Any, rows: Sequence[dict[str, Any]], figure: str) -> None:
    """PSNR or LPIPS while a method runs, or of its end alone, the best at the top in either; complete files of ours and
    of other codecs. Means over the pictures, curves from the time at which every picture has an error."""
    with_line, others = methods(rows)
    found = curves(rows, figure)
    last = []
    for method in with_line:
        look = style(DRAWN.index(method)) | {"label": name_of(method)}
        mine = [curve for name, curve in found if name == method]
        if mine and method not in COMPLETE:
            points = list(zip(*mean_curve(mine), strict=True))
            look["marker"] = ""
        else:
            points = ends(files_of(rows, method) if method in COMPLETE else at_rest(rows, method), figure)
        axes.plot(*zip(*points, strict=True), **look)
        last.append(points[0 if method in COMPLETE else -1][1])
    for method in others:
        points = ends([row for row in rows if row["method"] == method], figure)
        marks = style(DRAWN.index(method)) | {"linestyle": "none", "fillstyle": "none", "label": name_of(method)}
        axes.plot(*zip(*points, strict=True), **marks)
        last.append(points[0][1])
    axes.set(xscale="log", xlabel="seconds")
    if figure == "psnr":
        axes.set(ylabel="PSNR, dB", ylim=(math.floor(min(last)) - 2, None) if last else None)
    else:
        axes.set(ylabel="LPIPS, better upwards")
        axes.invert_yaxis()


def ends(rows: Sequence[dict[str, Any]], figure: str) -> list[tuple[float, float]]:
    """For each setting the seconds that an encode took and what came of it, means over the pictures."""
    groups = [[row for row in rows if row["setting"] == name] for name in dict.fromkeys(row["setting"] for row in rows)]
    return sorted(
        (statistics.fmean(row["seconds"] for row in group), statistics.fmean(row[figure] for row in group))
        for group in groups
    )


def mean_curve(curves: Sequence[Curve]) -> tuple[list[float], list[float]]:
    """Times at which one of the pictures was looked at, and the mean of the errors then."""
    times = sorted({seconds for curve in curves for seconds, _ in curve})
    times = [seconds for seconds in times if seconds >= max(curve[0][0] for curve in curves)]
    return times, [statistics.fmean(value_at(curve, seconds) for curve in curves) for seconds in times]


def value_at(curve: Curve, seconds: float) -> float:
    """The error then, between two looks on the line that a plot has: over the logarithm of the seconds."""
    return float(np.interp(math.log(seconds), [math.log(at) for at, _ in curve], [value for _, value in curve]))
