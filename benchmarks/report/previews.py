"""Previews: files of 32 to 4,096 bytes, beside placeholders and other codecs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from benchmarks.rd.report import SEEN, TITLES
from benchmarks.report.plots import style
from benchmarks.report.section import MISSING, Content, Page, mean, number, several, table

OURS, RIVALS = "sgmethod", ("WebP", "AVIF")  # the latter are those whose bytes for the same PSNR are told
CODECS = (OURS, "BlurHash", "ThumbHash", "WebP", "AVIF", "JPEG XL", "JPEG")
TOLD = (256, 512, 1024)  # bytes
Row = dict[str, Any]


def points(rows: Sequence[Row], codec: str, figure: str = "psnr") -> dict[int, tuple[float, float]]:
    """By bytes at most, the mean bytes and figure over all pictures; no point where a picture has none."""
    mine = [row for row in rows if row["codec"] == codec]
    images, found = {row["image"] for row in rows}, {}
    for most in sorted({row["max_bytes"] for row in mine}):
        these = [row for row in mine if row["max_bytes"] == most and figure in row]
        size, value = mean([row["bytes"] for row in these]), mean([row[figure] for row in these])
        if {row["image"] for row in these} == images and size is not None and value is not None:
            found[most] = size, value
    return found


def times_our_bytes(rows: Sequence[Row], most: int) -> float | None:
    """The bytes of WebP or AVIF, the better, for our mean PSNR at so many bytes, over ours; between points along the
    logarithm of bytes."""
    ours = points(rows, OURS).get(most)
    found = []
    for rival in RIVALS:
        curve = sorted((db, math.log(size)) for size, db in points(rows, rival).values())
        if ours and curve and curve[0][0] <= ours[1] <= curve[-1][0]:
            dbs, logs = np.array(curve).T
            found.append(math.exp(float(np.interp(ours[1], dbs, logs))) / ours[0])
    return min(found, default=None)


def page(contents: Mapping[str, Content]) -> Page:
    """The page from previews/kodak.json."""
    rows = contents["previews/kodak"]["rows"]
    return Page(
        name="previews",
        title="Previews",
        question="How good is a picture of a few hundred bytes? Other codecs first reduce the picture, by whichever "
        "factor gives them the highest PSNR, and enlarge it bicubically; AVIF runs at speed 6. BlurHash has as many "
        "components as fit. Bytes are those of whole files, headers included; a page needs 4 characters of text for 3 "
        "bytes.",
        table=by_bytes(rows),
        conclusion=conclusion(rows),
        limits="- What looks best: previews are softer than PSNR would have them, as readers picked those "
        "([why](../notebook/eye.md#should-previews-be-softer)).\n"
        "- A dash: some picture has no file so small, or none that differs from that of fewer bytes.\n"
        "- Other pictures, and single ones, which differ from the mean.\n"
        "- A `data:` URI adds some 23 characters to files of other codecs, and nothing to ours, BlurHash and "
        "ThumbHash, which need a decoder of their own.\n"
        "- Files without their headers: a page could keep those of JPEG once for all its pictures.\n"
        "- Times of a machine at rest: they are seconds of processor time, all threads added up.",
        command="python -m benchmarks --full --images KODAK --weights WEIGHTS --only previews",
        contents=contents,
        panels=[partial(draw, rows=rows, figure=figure) for figure in ("psnr", "lpips") if any_has(rows, figure)],
        of=f"means of {len({row['image'] for row in rows})} pictures of Kodak",
        appendix=[figures(rows)],
    )


def any_has(rows: Sequence[Row], figure: str) -> bool:
    """Whether the figure was measured at two sizes at least, which make a line."""
    return len(points(rows, OURS, figure)) > 1


def by_bytes(rows: Sequence[Row]) -> str:
    """Mean PSNR by bytes and codec."""
    found = {codec: points(rows, codec) for codec in CODECS}
    lines = []
    for most in sorted({row["max_bytes"] for row in rows}):
        cells = [number(found[codec].get(most, (0, None))[1], ".2f") for codec in CODECS]
        times = times_our_bytes(rows, most)
        lines.append([f"{most:,}", *cells, MISSING if times is None else f"{times:.2f} times ours"])
    return table(" | ".join(["bytes at most", *CODECS, "bytes of WebP or AVIF for our PSNR"]), lines)


def conclusion(rows: Sequence[Row]) -> str:
    """What others need for the same PSNR, and how far placeholders are behind."""
    times = {most: times_our_bytes(rows, most) for most in TOLD}
    parts = [f"{value:.2f} times our {most:,}" for most, value in times.items() if value is not None]
    told = f"For the same PSNR, the better of WebP and AVIF needs {several(parts)} bytes."
    ours = points(rows, OURS)
    others = []
    for name in ("BlurHash", "ThumbHash"):
        found = {most: point for most, point in points(rows, name).items() if most <= 64}
        if found:
            size, db = found[max(found)]
            others.append(f"{name} has {db:.1f} dB in {size:.0f} bytes")
    sizes = [f"{ours[most][1]:.1f} dB in {most} bytes" for most in (32, 64) if most in ours]
    if not others or not sizes:
        return told
    return f"{told} A preview has {several(sizes)}; {several(others)}."


def figures(rows: Sequence[Row]) -> str:
    """Every figure at the bytes at which the networks looked, of each codec's largest file up to there, and times."""
    at = max((row["max_bytes"] for row in rows if "lpips" in row and row["codec"] == OURS), default=TOLD[1])
    forms = {"bytes": ",.0f", "text": ",.0f", "psnr": ".2f", **SEEN, "encode_s": ".3f", "decode_ms": ".1f"}
    forms = {name: form for name, form in forms.items() if any(name in row for row in rows)}
    lines = []
    for codec in CODECS:
        sizes = [most for most in points(rows, codec) if most <= at]
        these = [row for row in rows if row["codec"] == codec and row["max_bytes"] == max(sizes, default=0)]
        if these:
            means = (number(mean([row.get(name) for row in these]), form) for name, form in forms.items())
            lines.append([codec, *means])
    names = {"text": "characters", "encode_s": "encode s", "decode_ms": "decode ms"}
    titles = " | ".join([f"at most {at:,} bytes", *(names.get(name, TITLES.get(name, name)) for name in forms)])
    return table(titles, lines)


def draw(axes: Any, rows: Sequence[Row], figure: str) -> None:
    """A figure against bytes."""
    for k, codec in enumerate(CODECS):
        found = [*points(rows, codec, figure).values()]
        if found:
            axes.plot(*zip(*found, strict=True), **style(k), label=codec)
    axes.set_xscale("log", base=2)
    axes.set(xlabel="bytes", ylabel="PSNR, dB" if figure == "psnr" else f"{TITLES[figure]}, better upwards")
    axes.xaxis.set_major_formatter("{x:,.0f}")
    if figure != "psnr":
        axes.invert_yaxis()
