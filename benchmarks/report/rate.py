"""Rate against quality on Kodak, beside other codecs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks import published
from benchmarks.rd.report import (
    ONE_QUALITY,
    SEEN,
    TITLES,
    Means,
    Row,
    against,
    against_cool_chic,
    against_quoted,
    curve,
    means,
)
from benchmarks.report.plots import style
from benchmarks.report.section import Content, Draw, Page, number, percent, several, table

NAMES = {
    "rd": "`rd`, tuned for PSNR",
    "rd visual": "`rd`, tuned for the eye (the default)",
    "avif tune=psnr": "AVIF, 4:4:4, speed 4, `tune=psnr`",
    "avif tune=psnr speed 0": "AVIF, 4:4:4, speed 0, `tune=psnr`",
    "avif tune=iq": "AVIF, 4:2:0, speed 4, `tune=iq`",
    "heic": "HEIC, x265, 4:2:0, `tune=psnr`",
    "jpeg2000": "JPEG 2000",
    "webp": "WebP, method 6",
    "jpegxl": "JPEG XL, effort 7",
    "mozjpeg": "mozjpeg, 4:2:0",
    "jpeg": "JPEG, 4:2:0",
}
ANCHOR = "GaussianImage"
BEST = ("VTM", "ELIC", "Cheng 2020, attention", "HM", "AV1 (libaom)")  # of the published codecs
BPP = 0.25  # of the table
MAX_BPP = 0.5  # of the plot
AVIF, AVIF_FOR_EYES = "avif tune=psnr", "avif tune=iq"  # its rows that are compared with
PATIENT = "rd effort 9", "avif tune=psnr speed 0"  # whatever it takes
SHOWN = (
    *("rd", "rd visual", PATIENT[0], AVIF, PATIENT[1], AVIF_FOR_EYES),
    *("heic", "jpegxl", "jpeg2000", "webp", "mozjpeg", "jpeg"),
)
PLOTTED = ("rd", "rd visual", AVIF, AVIF_FOR_EYES, "heic", "jpegxl", "webp", "jpeg")


def rows_of(*contents: Content) -> list[Row]:
    """The rows of all."""
    return [Row(**row) for content in contents for row in content["rows"]]


def name_of(codec: str) -> str:
    """A codec as readers see it: a known name, and the effort that may follow it."""
    known = max((name for name in NAMES if f"{codec} ".startswith(f"{name} ")), key=len, default="")
    return ", ".join(part for part in (NAMES.get(known, ""), codec.removeprefix(known).strip()) if part)


def page(contents: Mapping[str, Content]) -> Page:
    """The page from rd/*.json, as far as there are."""
    at_rates = [contents[f"rd/{n}"] for n in ("kodak", "effort", "avif") if f"rd/{n}" in contents]
    rows = rows_of(*at_rates)
    average = means(rows)
    panels: list[Draw] = [lambda axes: draw_psnr(axes, average)]
    if any(row.ssimulacra2 is not None for row in rows):
        panels.append(lambda axes: draw_ssimulacra2(axes, average))
    return Page(
        name="rate",
        title="Rate against quality",
        question="How many bits does each codec need for the same quality? Sizes are those of complete files, and "
        "quality is measured on the decoded pixels.",
        table=codecs_table(rows, average),
        conclusion=f"{for_psnr(rows)} {for_eyes(average)}",
        limits="".join(f"- Equal sizes: {told}\n" for told in [at_our_size(average)] if told)
        + limits(rows, contents.get("rd/quality")),
        command="python -m benchmarks --full --images KODAK --weights WEIGHTS --only rd",
        contents=contents,
        panels=panels,
        of=f"means of {len({row.image for row in rows})} pictures of Kodak",
    )


def codecs_table(rows: Sequence[Row], average: Means) -> str:
    """At BPP, the best PSNR first; bits are those for the same PSNR over all rates."""
    found = {codec: average[codec, BPP] for codec in SHOWN if (codec, BPP) in average}
    forms = {"bpp": ".3f", "psnr": ".2f", **SEEN, "encode_s": ".2g", "decode_ms": ".2g"}
    lines = []
    for codec, m in sorted(found.items(), key=lambda item: -(item[1]["psnr"] or 0)):
        bits = percent(against(rows, codec, AVIF)) if codec != AVIF else ""
        above = f" (over the limit on {m['above']:g} of {m['images']:g})" if m["above"] else ""
        lines.append([name_of(codec) + above, *(number(m[name], form) for name, form in forms.items()), bits])
    titles = [f"codec, at most {BPP:g} bits per pixel", *(TITLES.get(name, name) for name in forms)]
    return table(" | ".join([*titles, f"bits for the same PSNR, against {name_of(AVIF)}"]), lines)


def for_psnr(rows: Sequence[Row]) -> str:
    """One sentence on bits for the same PSNR."""
    told = []
    for rival in (AVIF, "heic", "webp"):
        if (rate := against(rows, "rd", rival)) is not None:
            told.append(f"{fewer(rate)} than {name_of(rival).partition(',')[0]}")
    return f"For the same PSNR, `rd` tuned for PSNR needs {several(told)}."


def for_eyes(average: Means) -> str:
    """One sentence on metrics that follow the eye, at BPP."""
    ours, avif = average.get(("rd visual", BPP)), average.get((AVIF_FOR_EYES, BPP))
    if not ours or not avif or ours["lpips"] is None:
        return "No metric that follows the eye was measured."
    better: list[str] = []
    worse: list[str] = []
    for name, form in SEEN.items():
        mine, theirs = ours[name] or 0, avif[name] or 0
        is_better = mine > theirs if name == "ssimulacra2" else mine < theirs
        (better if is_better else worse).append(f"{TITLES[name]} ({mine:{form}} against {theirs:{form}})")
    parts = [f"beats AVIF in {several(better)}"] * bool(better) + [f"trails it in {several(worse)}"] * bool(worse)
    return f"At {BPP:g} bits per pixel, the default, tuned for the eye, {' and '.join(parts)}."


def at_our_size(average: Means) -> str | None:
    """What AVIF would have in files as large as ours, in a sentence, between its own sizes along their logarithm."""
    psnr, score = value_at(average, AVIF, "rd", "psnr"), value_at(average, AVIF_FOR_EYES, "rd visual", "ssimulacra2")
    if psnr is None or score is None:
        return None
    ours, avif = (average[codec, BPP]["bpp"] or 0 for codec in ("rd", AVIF))
    return (
        f"AVIF's settings are coarse, and leave {100 * (1 - avif / ours):.0f} % of the bytes unused: in files as large "
        f"as ours, it would have {psnr:.1f} dB and an SSIMULACRA 2 of {score:.0f}."
    )


def value_at(average: Means, codec: str, other: str, figure: str) -> float | None:
    """A figure of a codec at the mean size of another's files of BPP; None where it has no smaller and larger ones."""
    size, points = average.get((other, BPP), {}).get("bpp"), sorted(curve(average, codec, figure))
    if size is None or not points or not points[0][0] <= size <= points[-1][0]:
        return None
    logs = [math.log(bpp) for bpp, _ in points]
    return float(np.interp(math.log(size), logs, [value for _, value in points]))


def limits(rows: Sequence[Row], one_quality: Content | None) -> str:
    """What the page does not show: other codecs, other pictures, other rates."""
    told = ahead(rows, one_quality)
    others = several([f"{fewer(rate)} than {name.replace(', ', ' with ')}" for name, rate in told.items()])
    published = f"- Codecs that were not run here. By their published figures, `rd` needs {others} for the same PSNR.\n"
    spread = ""
    if against(rows, "rd", AVIF) is not None:
        least, most = by_picture(rows, "rd", AVIF)
        spread = f" (from {least:+.0f} to {most:+.0f} % against AVIF)"
    return (
        f"{published if others else ''}- Single pictures, which differ from the mean{spread}, and pictures unlike "
        "Kodak's: text, screenshots, drawings.\n"
        "- Human judgement: these are metrics ([what people see](seen.md)).\n"
        "- Exact ratios of times: rows were not measured side by side, and our times include the search for the "
        "quality that fits, while those of other codecs do not ([speed](speed.md)). AVIF is decoded by one thread "
        "here, and there by all."
    )


def ahead(rows: Sequence[Row], one_quality: Content | None) -> dict[str, float]:
    """BD-rates of rd against published codecs, in percent: those of BEST have one quality for all pictures."""
    average = means(rows_of(one_quality)) if one_quality else {}
    found = {other: against_quoted(average, f"rd {ONE_QUALITY}", other) for other in BEST}
    found["Cool-Chic 5.0"] = against_cool_chic(rows, "rd")
    return {other: rate for other, rate in found.items() if rate is not None}


def by_picture(rows: Sequence[Row], codec: str, anchor: str) -> tuple[float, float]:
    """The least and the most of a codec's BD-rates for the same PSNR over the pictures that both have."""
    images = dict.fromkeys(row.image for row in rows if row.codec == codec)
    found = (against([row for row in rows if row.image == image], codec, anchor) for image in images)
    rates = [rate for rate in found if rate is not None]
    return min(rates), max(rates)


def fewer(rate: float) -> str:
    """A difference in rate, in words."""
    return f"{abs(rate):.1f} % {'fewer' if rate < 0 else 'more'} bits"


def lines_of(average: Means) -> dict[str, dict[str, Any]]:
    """Every codec that has a curve, the best first, and how its line looks."""
    codecs = [codec for codec in PLOTTED if (codec, BPP) in average]
    levels = {codec: average.get((codec, BPP), {}).get("psnr") for codec in codecs}
    found = sorted(codecs, key=lambda codec: -(levels[codec] or 0))
    return {codec: style(k) | {"label": name_of(codec).replace("`", "")} for k, codec in enumerate(found)}


def draw_psnr(axes: Any, average: Means) -> None:
    """PSNR against bits per pixel."""
    shown = lines_of(average)
    for codec, how in shown.items():
        axes.plot(*zip(*sorted(curve(average, codec)), strict=True), **how)
    quoted = [(p["bpp"], p["psnr"]) for p in published.kodak()[ANCHOR]["points"] if p["bpp"] < MAX_BPP]
    axes.plot(*zip(*quoted, strict=True), **style(len(shown)), label=f"{ANCHOR}, quoted")
    axes.set(xlabel="bits per pixel", ylabel="PSNR, dB")


def draw_ssimulacra2(axes: Any, average: Means) -> None:
    """SSIMULACRA 2 against bits per pixel, of what has it."""
    for codec, how in lines_of(average).items():
        if found := sorted(curve(average, codec, "ssimulacra2")):
            axes.plot(*zip(*found, strict=True), **how)
    axes.set(xlabel="bits per pixel", ylabel="SSIMULACRA 2")
