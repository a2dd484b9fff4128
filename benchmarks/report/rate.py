"""Rate against quality on Kodak, beside other codecs."""

from __future__ import annotations

import math
import re
from functools import cache
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
from benchmarks.report import results
from benchmarks.report.plots import style
from benchmarks.report.results import load, percent
from benchmarks.tables import number, table

NAMES = {
    "rd": "`rd`, tuned for PSNR",
    "rd effort 9": "`rd`, tuned for PSNR, effort 9",
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
AVIF, AVIF_VISUAL = "avif tune=psnr", "avif tune=iq"
BPP = 0.25  # of the tables
MAX_BPP = 0.5  # of the plot
PLOTTED = ("rd", "rd visual", AVIF, AVIF_VISUAL, "heic", "jpegxl", "webp", "jpeg")
ANCHOR = "GaussianImage"
# Published codecs, and their names in marks. Cool-Chic is compared picture by picture.
QUOTED = {"vtm": "VTM", "elic": "ELIC", "cheng": "Cheng 2020, attention", "hm": "HM", "av1": "AV1 (libaom)"}

# README's columns: the codec tuned for PSNR, and for the eye; they differ only where a codec can be tuned.
README_CODECS = {
    "sgmethod": ("rd", "rd visual"),
    "AVIF": (AVIF, AVIF_VISUAL),
    "JPEG XL": ("jpegxl", "jpegxl"),
    "WebP": ("webp", "webp"),
    "JPEG": ("jpeg", "jpeg"),
}
# README's rows: column of the JSON, its format, what picks the best, which of the two codecs is measured, and a factor.
README_ROWS = {
    "PSNR, dB ↑": ("psnr", ".1f", max, 0, 1),
    "LPIPS ↓": ("lpips", ".2f", min, 1, 1),
    "SSIMULACRA 2 ↑": ("ssimulacra2", ".0f", max, 1, 1),
    "Decoding, ms ↓": ("decode_ms", ".1f", min, 1, 1),
    "Encoding, ms ↓": ("encode_s", ",.0f", min, 1, 1000),
    "Size, kB": ("bytes", ".1f", None, 1, 1e-3),
}
LIBRARIES = ("libavif-", "libjxl-", "libwebp-", "libjpeg_turbo-")


@cache
def rows() -> tuple[Row, ...]:
    """The rows of all files that were made for a rate."""
    return tuple(Row(**row) for name in ("rd/kodak", "rd/effort", "rd/avif") for row in results.rows(name))


@cache
def average() -> Means:
    """Their means over pictures."""
    return means(rows())


def codecs_table() -> str:
    """At BPP, the best PSNR first; bits are those for the same PSNR over all rates."""
    found = {codec: average()[codec, BPP] for codec in NAMES}
    forms = {"bpp": ".3f", "psnr": ".2f", **SEEN, "encode_s": ".2g", "decode_ms": ".2g"}
    lines = []
    for codec, m in sorted(found.items(), key=lambda item: -(item[1]["psnr"] or 0)):
        bits = percent(against(rows(), codec, AVIF)) if codec != AVIF else ""
        above = f" (over the limit on {m['above']:g} of {m['images']:g})" if m["above"] else ""
        lines.append([NAMES[codec] + above, *(number(m[name], form) for name, form in forms.items()), bits])
    titles = [f"codec, at most {BPP:g} bits per pixel", *(TITLES.get(name, name) for name in forms)]
    return table(" | ".join([*titles, f"bits for the same PSNR, against {NAMES[AVIF]}"]), lines)


def readme_table() -> str:
    """The README's table at BPP, with the best of each row in bold, and the versions of other codecs."""
    lines = []
    for title, (name, form, best_of, tuned, factor) in README_ROWS.items():
        values = [average()[codecs[tuned], BPP][name] or 0 for codecs in README_CODECS.values()]
        best = best_of(values) if best_of else None
        cells = [number(value * factor, form) for value in values]
        lines.append([title, *(f"**{c}**" if v == best else c for c, v in zip(cells, values, strict=True))])
    # The last libavif, Pillow's, is the one that made these files.
    named = load("rd/kodak")["settings"]["codecs"]
    versions = dict(re.split("[-/ ]", name)[:2] for name in named if name.startswith(LIBRARIES))
    codecs = ", ".join(f"{library.replace('_', '-')} {version}" for library, version in sorted(versions.items()))
    return f"{table(' | '.join(['', *README_CODECS]), lines)}\n\nMeasured with {codecs}."


def figures() -> dict[str, float | None]:
    """The figures of sentences, by mark."""
    found: dict[str, float | None] = {}
    for mark, codec in {"avif": AVIF, "heic": "heic", "webp": "webp"}.items():  # at equal PSNR
        found[f"rate.fewer-than-{mark}"] = -(against(rows(), "rd", codec) or 0)
    for mark, codec in {"rd": "rd visual", "avif": AVIF_VISUAL, "grain": "avif grain"}.items():
        found |= {f"rate.{mark}-{name}": average()[codec, BPP][name] for name in SEEN}
    sizes = [average()[codec, BPP]["bpp"] or 0 for codec in ("rd", AVIF)]
    found["rate.avif-unused"] = 100 * (1 - sizes[1] / sizes[0])
    found["rate.avif-filled-psnr"] = value_at(average(), AVIF, "rd", "psnr")
    found["rate.avif-filled-ssimulacra2"] = value_at(average(), AVIF_VISUAL, "rd visual", "ssimulacra2")
    by_image = [against([row for row in rows() if row.image == i], "rd", AVIF) for i in {row.image for row in rows()}]
    found["rate.most-fewer"], found["rate.least-fewer"] = (-f(r for r in by_image if r is not None) for f in (min, max))
    one_quality = means([Row(**row) for row in results.rows("rd/quality")])
    for mark, codec in QUOTED.items():
        found[f"rate.more-than-{mark}"] = more = against_quoted(one_quality, f"rd {ONE_QUALITY}", codec) or 0
        found[f"rate.fewer-than-{mark}"] = -more
    found["rate.more-than-cool-chic"] = against_cool_chic(rows(), "rd")
    found["rate.times-gaussianimage"] = 100 / (100 + (against_quoted(average(), "rd", ANCHOR) or 0))
    return found


def value_at(average: Means, codec: str, other: str, figure: str) -> float | None:
    """A figure of a codec at the mean size of another's files of BPP; None where it has no smaller and larger ones."""
    size, points = average.get((other, BPP), {}).get("bpp"), sorted(curve(average, codec, figure))
    if size is None or not points or not points[0][0] <= size <= points[-1][0]:
        return None
    logs = [math.log(bpp) for bpp, _ in points]
    return float(np.interp(math.log(size), logs, [value for _, value in points]))


def draw(axes: Any, figure: str) -> None:
    """PSNR or SSIMULACRA 2 against bits per pixel, the best codec first."""
    codecs = sorted(PLOTTED, key=lambda codec: -(average()[codec, BPP]["psnr"] or 0))
    for k, codec in enumerate(codecs):
        how = style(k) | {"label": NAMES[codec].replace("`", "")}
        axes.plot(*zip(*sorted(curve(average(), codec, figure)), strict=True), **how)
    if figure == "psnr":
        quoted = [(p["bpp"], p["psnr"]) for p in published.kodak()[ANCHOR]["points"] if p["bpp"] < MAX_BPP]
        axes.plot(*zip(*quoted, strict=True), **style(len(codecs)), label=f"{ANCHOR}, quoted")
    axes.set(xlabel="bits per pixel", ylabel="PSNR, dB" if figure == "psnr" else TITLES[figure])
