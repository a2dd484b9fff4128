"""Beside codecs that others published, which nobody measured here."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks import published
from benchmarks.rd.report import (
    LOW_DB,
    ONE_QUALITY,
    Means,
    Row,
    against,
    against_cool_chic,
    against_quoted,
    curve,
    means,
    quoted_curve,
    scaled,
    shared_bpp,
    shared_db,
)
from benchmarks.report.fits import quoted as papers_tables
from benchmarks.report.plots import style
from benchmarks.report.rate import ANCHOR, AVIF, MAX_BPP, RATES, at, fewer, first, name_of, percent, rows_of
from benchmarks.report.section import Content, Section, number, table

DRAWN = ("VTM", "ELIC", "Cheng 2020, attention", "HM", "AV1 (libaom)")  # of one quality for all pictures


def section(
    main: Content | None,
    effort: Content | None,
    paper: Content | None,
    one_quality: Content | None,
    effort_one_quality: Content | None,
) -> Section:
    """From rd/kodak.json, rd/effort.json, rd/paper.json, rd/quality.json and rd/effort-quality.json, as far
    as there are."""
    at_qualities = [content for content in (one_quality, effort_one_quality) if content]
    at_rates = [content for content in (main, effort, paper) if content]
    rows, of_qualities = rows_of(*at_rates), rows_of(*at_qualities)
    average = means(rows)
    rates = {
        f"{ANCHOR} ({shared_db(average, 'rd', ANCHOR)} dB, for which it takes {shared_bpp(average, 'rd', ANCHOR)} bpp, "
        "by points read off its figure)": against_quoted(average, "rd", ANCHOR),
        "Cool-Chic 5.0": first(against_cool_chic(rows, "rd")),
        **ahead(of_qualities),
    }
    told = [f"{fewer(rate)} than {name}" for name, rate in rates.items() if rate is not None]
    said = (
        "How far is profile `rd`, tuned for PSNR, from codecs that were not measured here? For the same PSNR it needs "
        f"{', '.join(told)}. Others' means say nothing of single pictures, and the two ways to average, one rate and "
        "one quality for all pictures, do not compare with one another."
    )
    tables = [differences(rows, average)]
    tables += [at_one_quality(of_qualities)] if at_qualities else []
    panels = [lambda axes: draw(axes, means(of_qualities))] if at_qualities else []
    return Section(
        "rate_published",
        "Rate against quality, beside what others published",
        said,
        [*tables, quoted(), papers()],
        [*at_rates, *at_qualities],
        panels,
        "Kodak, one quality for all pictures",
    )


def ahead(rows: Sequence[Row]) -> dict[str, float | None]:
    """Those of the best that have one quality for all pictures, and what rd needs against each, in percent."""
    average = means(rows)
    return {other.replace(", ", " with "): against_quoted(average, f"rd {ONE_QUALITY}", other) for other in DRAWN}


def differences(rows: Sequence[Row], average: Means) -> str:
    """BD-rates, each against what averages in the same way."""
    titles = "codec | against GaussianImage, quoted, of means | from and to, dB | "
    titles += f"against Cool-Chic 5.0, quoted, mean of pictures | the same below {LOW_DB} dB | "
    titles += "against AVIF, speed 4, `tune=psnr`, mean of pictures"
    lines = []
    for codec in dict.fromkeys(codec for codec, _ in average):
        found = (
            against_quoted(average, codec, ANCHOR),
            first(against_cool_chic(rows, codec)),
            None if codec == AVIF else first(against(rows, codec, AVIF)),
        )
        low = against_cool_chic(rows, codec, LOW_DB)
        cells = [*map(percent, found)]
        cells.insert(2, percent(low[0]) + f" ({low[1]})" if low else percent(None))
        cells.insert(1, shared_db(average, codec, ANCHOR))
        lines.append([name_of(codec), *cells])
    note = (
        "BD-rate for the same PSNR, below 0 for fewer bits, of the qualities that both reach: figures over other dB "
        f"do not compare. Below {LOW_DB} dB only points below that count, of the pictures (in brackets, how many) that "
        "have two. No figure where on some picture the two share no quality."
    )
    return f"{note}\n\n" + table(titles, lines)


def at_one_quality(rows: Sequence[Row]) -> str:
    """Against published means over pictures of one quality, as these are."""
    average = means(rows)
    ours = list(dict.fromkeys(row.codec for row in rows))
    names = [name_of(codec.removesuffix(f" {ONE_QUALITY}")) for codec in ours]
    titles = ["against, quoted", *(f"{name}: {kind}" for name in names for kind in ("PSNR", "MS-SSIM"))]
    lines = []
    for other in published.kodak():
        found = [against_quoted(average, codec, other, column) for codec in ours for column in (1, 2)]
        if any(rate is not None for rate in found):
            lines.append([other, *map(percent, found)])
    qualities = ", ".join(f"{quality:g}" for quality in sorted({row.aim for row in rows}))
    note = (
        f"BD-rate of means over pictures, at one quality for all of them (ours: {qualities}; theirs: as published), "
        "below 0 for fewer bits:"
    )
    return f"{note}\n\n" + table(" | ".join(titles), lines)


def quoted() -> str:
    """Published curves, at the rates that are measured here. Their means are of another kind."""
    lines = []
    for name, codec in published.kodak().items():
        points = codec["points"]
        known = [(p["bpp"], p["psnr"], p.get("ms_ssim")) for p in points]
        cells = [number(at(known, rate, 1), ".2f") for rate in RATES]
        cells += [number(at(known, rate, 2), ".4f") for rate in RATES]
        lines.append([name, *cells, codec["averaged"], codec["source"]])
    titles = " | ".join(["codec", *(f"PSNR at {r:g}" for r in RATES), *(f"MS-SSIM at {r:g}" for r in RATES)])
    note = (
        "Quoted, not measured here, interpolated between published points. Means at one quality for all pictures are "
        "lower than means at one rate for all: do not compare those with the first table."
    )
    return f"{note}\n\n" + table(f"{titles} | means | source", lines)


def papers() -> str:
    """The paper's own codecs table, of other pictures, and what it says of Kodak."""
    paper = published.paper()
    return "\n\n".join(
        [
            f"The paper says of its own codec that it needs {-paper['bd_rate_kodak_percent']:g} % fewer bits than "
            f"GSImage on Kodak, and {-paper['bd_rate_div2k_percent']:g} % fewer on DIV2K at half the size.",
            *papers_tables("codecs"),
        ]
    )


def draw(axes: Any, average: Means) -> None:
    """PSNR against bits per pixel, at one quality for all pictures."""
    ours = list(dict.fromkeys(codec for codec, _ in average if not codec.startswith("rd visual")))
    for k, codec in enumerate(ours):
        label = name_of(codec.removesuffix(f" {ONE_QUALITY}")).replace("`", "")
        axes.plot(*zip(*sorted(scaled(curve(average, codec), 1)), strict=True), **style(k) | {"label": label})
    for k, other in enumerate(DRAWN, len(ours)):
        points = [point for point in scaled(quoted_curve(other), 1) if point[0] < MAX_BPP]
        axes.plot(*zip(*sorted(points), strict=True), **style(k) | {"label": f"{other}, quoted"})
    axes.set(xlabel="bits per pixel", ylabel="PSNR, dB")
