"""Rate against quality on Kodak: measured here, and quoted."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from benchmarks import published
from benchmarks.rd.report import Means, Row, bd_rate, curve, means, scaled
from benchmarks.report.section import Content, Section, number, table

NAMES = {
    "rd": "`rd`",
    "paper": "`paper`",
    "baseline": "`baseline`",
    "avif": "AVIF, 4:2:0, speed 4",
    "jpeg2000": "JPEG 2000",
    "webp": "WebP, method 6",
    "jpegxl": "JPEG XL, effort 7",
    "jpeg": "JPEG, 4:2:0",
}
RATES = (0.15, 0.25, 0.4)
ANCHOR = "GaussianImage"


def rows_of(*contents: Content) -> list[Row]:
    """All of them."""
    return [Row(**row) for content in contents for row in content["rows"]]


def section(*measured_in: Content | None) -> Section:
    """From kodak-rd.json and kodak-paper.json, as far as there are."""
    contents = [content for content in measured_in if content]
    rows = rows_of(*contents)
    average = means(rows)
    told = [
        f"{abs(rate):.1f} % {'fewer' if rate < 0 else 'more'} bits than {name}"
        for name, rate in (
            ("GaussianImage as published", rate_against_quoted(average, "rd")),
            ("AVIF", against(rows, "rd", "avif")),
            ("Cool-Chic 5.0 as published", against_cool_chic(rows, "rd")),
        )
        if rate is not None
    ]
    said = (
        "How many bits does each codec need for the same PSNR, by the sizes of real files and the pixels decoded from "
        f"them? Profile `rd` needs {', '.join(told)}. Kodak alone, and PSNR and MS-SSIM alone, are no "
        "statement on other pictures, nor on what an eye sees."
    )
    tables = [measured(average), differences(rows, average), quoted()]
    return Section("rate", "Rate against quality", said, tables, contents, draw=lambda axes: draw(axes, average))


def measured(average: Means) -> str:
    """Means over the pictures for each codec and rate."""
    titles = "codec | bpp at most | pictures | bytes | bpp | PSNR | MS-SSIM | Gaussians | encode s | decode ms"
    forms = {"images": "g", "bytes": ".0f", "bpp": ".4f", "psnr": ".2f", "ms_ssim": ".4f", "gaussians": ".0f"}
    forms |= {"encode_s": ".2f", "decode_ms": ".2f"}
    cells = [
        [NAMES[codec], f"{limit:g}", *(number(m[name], form) for name, form in forms.items())]
        for (codec, limit), m in sorted(average.items(), key=lambda item: (item[0][1], -(item[1]["psnr"] or 0)))
    ]
    return table(titles, cells)


def differences(rows: Sequence[Row], average: Means) -> str:
    """BD-rates, each against what averages in the same way."""
    titles = "codec | against GaussianImage, quoted, of means | against Cool-Chic 5.0, quoted, mean of pictures | "
    titles += "against AVIF, mean of pictures"
    lines = []
    for codec in dict.fromkeys(codec for codec, _ in average):
        found = (rate_against_quoted(average, codec), against_cool_chic(rows, codec), against(rows, codec, "avif"))
        lines.append([NAMES[codec], *(number(rate, "+.1f") + (" %" if rate is not None else "") for rate in found)])
    return "BD-rate for the same PSNR, below 0 for fewer bits:\n\n" + table(titles, lines)


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
        "lower than means at one rate for all: do not compare those with the table above."
    )
    return f"{note}\n\n" + table(f"{titles} | means | source", lines)


def at(points: Sequence[tuple[Any, ...]], rate: float, column: int) -> float | None:
    """A published quality at a rate, None beyond the points."""
    known = sorted((p[0], p[column]) for p in points if p[column] is not None)
    if len(known) < 2 or not known[0][0] <= rate <= known[-1][0]:
        return None
    rates, values = np.array(known).T
    return float(PchipInterpolator(np.log(rates), values)(np.log(rate)))


def rate_against_quoted(average: Means, codec: str) -> float | None:
    """BD-rate against GaussianImage as published; both are means at one rate."""
    anchor = [(p["bpp"], p["psnr"]) for p in published.kodak()[ANCHOR]["points"]]
    return bd_rate(anchor, scaled(curve(average, codec), 1))


def against(rows: Sequence[Row], codec: str, other: str) -> float | None:
    """The mean over pictures of each one's BD-rate. None where one picture has none."""
    if codec == other:
        return None
    return _mean_rate({row.image: points(rows, other, row.image) for row in rows}, rows, codec)


def against_cool_chic(rows: Sequence[Row], codec: str) -> float | None:
    """The same against the points of Cool-Chic's table."""
    known = published.cool_chic()
    return _mean_rate({row.image: known.get(Path(row.image).stem, []) for row in rows}, rows, codec)


def points(rows: Sequence[Row], codec: str, image: str) -> list[tuple[float, float]]:
    """Bits per pixel and PSNR of one picture."""
    return [(r.bpp, r.psnr) for r in rows if (r.codec, r.image) == (codec, image) and r.psnr is not None]


def _mean_rate(anchors: dict[str, list[tuple[float, float]]], rows: Sequence[Row], codec: str) -> float | None:
    rates = [bd_rate(anchor, points(rows, codec, image)) for image, anchor in anchors.items()]
    known = [rate for rate in rates if rate is not None]
    return statistics.fmean(known) if known and len(known) == len(rates) else None


def draw(axes: Any, average: Means) -> None:
    """PSNR against bits per pixel; every curve has its own marks and line."""
    styles = cycle([("-", "o"), ("--", "s"), ("-.", "^"), (":", "D"), ("-", "v"), ("--", "x"), ("-.", "P")])
    for codec in dict.fromkeys(codec for codec, _ in average):
        shown = sorted(scaled(curve(average, codec), 1))
        line, mark = next(styles)
        axes.plot(*zip(*shown, strict=True), line, marker=mark, label=NAMES[codec].strip("`"))
    shown = [(p["bpp"], p["psnr"]) for p in published.kodak()[ANCHOR]["points"] if p["bpp"] < 0.75]
    axes.plot(*zip(*shown, strict=True), ":", marker="*", label=f"{ANCHOR}, quoted")
    axes.set(xlabel="bits per pixel", ylabel="PSNR, dB")
