"""Time and memory: by size beside other codecs, and how they grow."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from benchmarks.report.plots import style
from benchmarks.report.section import MISSING, Content, Draw, Page, seconds, several, table
from benchmarks.speed.growth import AXES, exponent, growth_table, means

SIZES = ("convergence/kodak", "convergence/2-megapixels", "convergence/12-megapixels")
METHODS = {
    ("rd", "effort 1"): "`rd`, effort 1, tuned for PSNR",
    ("rd", ""): "`rd`, tuned for PSNR",
    ("rd visual", "effort 1"): "`rd`, effort 1, tuned for the eye",
    ("rd visual", ""): "`rd`, tuned for the eye (the default)",
    ("avif", "10"): "AVIF, speed 10",
    ("avif", "6"): "AVIF, speed 6",
    ("avif", "4"): "AVIF, speed 4",
    ("jpegxl", "7"): "JPEG XL, effort 7",
    ("webp", "4"): "WebP, method 4",
    ("jpeg", "0"): "JPEG",
}
DRAWN = ("rd", "rd visual", "paper", "avif", "jpegxl", "webp", "jpeg")
LABELS = {"rd": "rd, by effort or time limit", "rd visual": "rd, tuned for the eye", "avif": "avif, by speed"}
DECODERS = {"jpeg": "libjpeg-turbo", "avif": "AVIF"}
GROWTH = (
    "Seconds by pixels for a fixed size of the file, and by bytes for a fixed size of the picture, means over "
    "photographs of a camera. AVIF of a large picture cannot be as small as some of these files and is then at its "
    "lowest quality; reduced, its sides are first divided by two or more."
)
Rows = Sequence[dict[str, Any]]


def page(contents: Mapping[str, Content]) -> Page:
    """The page from convergence/*.json, speed.json and growth.json, as far as there are."""
    by_size = {size_of(content): content["rows"] for name, content in contents.items() if name in SIZES}
    ends = dict.fromkeys((min(by_size), max(by_size)))
    panels: list[Draw] = [partial(draw, rows=by_size[size], size=size) for size in ends]
    speed, growth = contents.get("speed"), contents.get("growth")
    return Page(
        name="speed",
        title="Speed and memory",
        question="How long do encoding and decoding take at 0.25 bits per pixel on the same cores, and how does that "
        "grow with the picture? Each cell gives the time of one encode and the PSNR it reached.",
        table=sizes_table(by_size),
        conclusion=" ".join(
            [
                hurry(by_size),
                *([by_pixels(growth)] if growth else []),
                *([decoding(speed["rows"])] if speed else []),
            ]
        ),
        limits="- Photographs of 2 and 12 megapixels from a camera: larger pictures are mosaics of Kodak's.\n"
        "- Repeatable seconds: a time differs from hour to hour, so trust the ratios more.\n"
        f"{unused(by_size)}"
        "- The search for the quality that fits a size, which other codecs' times leave out.",
        command="python -m benchmarks --full --images KODAK --only speed,convergence\n"
        "python -m benchmarks.speed growth --images LARGE --megapixels 0.75,3,12 --bytes 500,2000,10000,50000 "
        "--repeats 1 --out benchmarks/results/growth.json",
        contents=contents,
        panels=panels,
        of="PSNR against seconds, means over the pictures of each size",
        appendix=[
            *([grows(speed["rows"])] if speed else []),
            *([GROWTH, *(growth_table(growth["rows"], growth["settings"], axis) for axis in AXES)] if growth else []),
        ],
    )


def by_pixels(growth: Content) -> str:
    """How an encode into a fixed number of bytes grows with the picture, in a sentence."""
    found = dict(means(growth["rows"], growth["settings"], "megapixels"))
    (small, first, _), *_, (large, last, _) = found["rd visual"]
    size = f"{growth['settings']['max_bytes']:,} bytes"
    return f"An encode of {large:g} megapixels into {size} takes {last / first:.1f} times as long as one of {small:g}."


def size_of(content: Content) -> float:
    """Megapixels of the pictures in a JSON."""
    return float(content["rows"][0]["megapixels"])


def at(rows: Rows, method: str, setting: str) -> tuple[float, float] | None:
    """Mean seconds and dB of a method and setting."""
    mine = [row for row in rows if (row["method"], row["setting"]) == (method, setting)]
    if not mine:
        return None
    return statistics.fmean(row["seconds"] for row in mine), statistics.fmean(row["psnr"] for row in mine)


def sizes_table(by_size: Mapping[float, Rows]) -> str:
    """A line for each method, a column for each size."""
    lines = []
    for key, name in METHODS.items():
        found = [at(rows, *key) for rows in by_size.values()]
        if any(found):
            lines.append([name, *(f"{seconds(one[0])} s, {one[1]:.1f} dB" if one else MISSING for one in found)])
    counts = {size: len({row["picture"] for row in rows}) for size, rows in by_size.items()}
    titles = [f"{size:g} megapixels ({n} picture{'s' * (n > 1)})" for size, n in counts.items()]
    return table(" | ".join(["method", *titles]), lines)


def hurry(by_size: Mapping[float, Rows]) -> str:
    """The smallest and the largest size beside AVIF, in a sentence."""
    told = []
    for size in dict.fromkeys((min(by_size), max(by_size))):
        ours, avif = (at(by_size[size], *key) for key in (("rd", ""), ("avif", "6")))
        if ours and avif:
            change = f"{'gains' if ours[1] > avif[1] else 'loses'} {abs(ours[1] - avif[1]):.1f} dB"
            told.append(f"takes {ours[0] / avif[0]:.0f} times as long and {change} at {size:g} megapixels")
    if not told:
        return "AVIF was not measured."
    return f"Compared with AVIF at speed 6, an encode tuned for PSNR {', and '.join(told)}."


def unused(by_size: Mapping[float, Rows]) -> str:
    """A line on how much smaller AVIF's files are, whose settings are coarse."""
    rows = by_size[max(by_size)]
    ours, avif = (
        [row["bytes"] for row in rows if (row["method"], row["setting"]) == key] for key in (("rd", ""), ("avif", "6"))
    )
    if not ours or not avif:
        return ""
    smaller = 100 * (1 - statistics.fmean(avif) / statistics.fmean(ours))
    return (
        f"- Equal sizes: AVIF's settings are coarse, and its files at speed 6 are {smaller:.0f} % smaller than ours at "
        f"{max(by_size):g} megapixels.\n"
    )


def decoding(rows: Rows) -> str:
    """Milliseconds of a decode at about Kodak's size and of the largest, beside others, in a sentence."""
    told = []
    sizes = [row for row in rows if row["what"] == "size"]
    for row in (row for row in sizes if row["megapixels"] in (0.4, sizes[-1]["megapixels"])):
        others = row["rivals_decode_ms"]
        pairs = [(title, others[name]) for name, title in DECODERS.items() if name in others]
        beside = several([f"{row['decode_ms'] / theirs:.1f} times {title}'s time" for title, theirs in pairs])
        told.append(f"{row['decode_ms']:.1f} ms at {row['megapixels']:g} megapixels ({beside})")
    return f"A decode takes {several(told)}." if told else ""


def grows(rows: Rows) -> str:
    """The powers with which time and memory grow, in a sentence."""
    sizes = [row for row in rows if row["what"] == "size"]
    pixels = [row["pixels"] for row in sizes]
    figures = {
        "an encode": [statistics.median(row["encode_s"]) for row in sizes],
        "a decode": [row["decode_ms"] for row in sizes],
        "an encode's memory": [row["encode_mib"] for row in sizes],
    }
    told = [f"{exponent(pixels, values) or 0:.2f} for {what}" for what, values in figures.items()]
    most = f"{sizes[-1]['encode_mib']:,.0f} MiB at {sizes[-1]['megapixels']:g} megapixels"
    return f"Cost grows as a power of the number of pixels: {several(told)} ({most}). The CSV of speed has each size."


def draw(axes: Any, rows: Rows, size: float) -> None:
    """PSNR against seconds at one size."""
    lows = []
    for k, method in enumerate(DRAWN):
        mine = [row for row in rows if row["method"] == method]
        if not mine:
            continue
        settings = dict.fromkeys(row["setting"] for row in mine)
        points = sorted(point for setting in settings if (point := at(mine, method, setting)))
        look = {"linestyle": "none"} if method in ("webp", "jpeg") else {}
        axes.plot(*zip(*points, strict=True), **style(k) | look | {"label": LABELS.get(method, method)})
        lows.append(max(db for _, db in points))
    axes.set(
        xscale="log", xlabel=f"seconds, {size:g} megapixels", ylabel="PSNR, dB", ylim=(math.floor(min(lows)) - 4, None)
    )
