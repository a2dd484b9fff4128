"""Time and memory: by size beside other codecs, and how they grow."""

from __future__ import annotations

import math
import statistics
from typing import Any

from benchmarks.convergence import until_table
from benchmarks.report.plots import style
from benchmarks.report.results import Row, load, rows, seconds
from benchmarks.speed.growth import growth_table
from benchmarks.tables import MISSING, number, standard_error, table

SIZES = {0.4: "convergence/0.4-megapixels", 4: "convergence/4-megapixels", 12: "convergence/12-megapixels"}
ONE_CORE = [f"convergence/{size}-megapixels-1-core" for size in ("0.4", "4")]
COSTS = {
    ("rd", "effort 1"): "`rd`, effort 1, tuned for PSNR",
    ("rd", ""): "`rd`, tuned for PSNR",
    ("rd visual", "effort 1"): "`rd`, effort 1, tuned for the eye",
    ("rd visual", ""): "`rd`, tuned for the eye (the default)",
    ("avif", "9"): "AVIF of 10 bits, `tune=psnr`, speed 9",
    ("avif", "6"): "AVIF of 10 bits, `tune=psnr`, speed 6",
    ("avif", "4"): "AVIF of 10 bits, `tune=psnr`, speed 4",
    ("jpegxl", "7"): "JPEG XL, effort 7",
    ("webp", "6"): "WebP, method 6",
    ("jpeg", "0"): "JPEG",
    ("rd fidelity", "effort 1"): "`rd`, effort 1, tuned for fidelity",
    ("rd fidelity", ""): "`rd`, tuned for fidelity",
    ("avif visual", "6"): "AVIF of 10 bits, `tune=iq`, speed 6",
    ("avif visual", "4"): "AVIF of 10 bits, `tune=iq`, speed 4",
}
FIGURES = ("seconds", "encode_s", "mib", "decode_ms", "psnr", "ssimulacra2", "bytes")  # of which some have no encode_s
DRAWN = ("rd", "rd visual", "paper", "avif", "jpegxl", "webp", "jpeg")
LABELS = {"rd": "rd, tuned for PSNR, by effort or time limit", "rd visual": "rd, tuned for the eye, by effort"}
LABELS |= {"avif": "AVIF of 10 bits, tune=psnr, by speed", "jpegxl": "JPEG XL", "webp": "WebP", "jpeg": "JPEG"}


def of(megapixels: float, method: str, setting: str) -> dict[str, Row]:
    """Rows of a method and setting by picture of one size."""
    own = [row for row in rows(SIZES[megapixels]) if (row["method"], row["setting"]) == (method, setting)]
    return {row["picture"]: row for row in own}


def at(megapixels: float, method: str, setting: str) -> dict[str, float] | None:
    """Means of a method and setting over the pictures of one size.

    psnr_error: the standard error of the mean difference from `rd` at its default, picture by picture.
    """
    mine, ours = of(megapixels, method, setting), of(megapixels, "rd", "")
    if not mine:
        return None
    measured = [name for name in FIGURES if name in next(iter(mine.values()))]
    found = {name: statistics.fmean(row[name] for row in mine.values()) for name in measured}
    apart = [row["psnr"] - ours[picture]["psnr"] for picture, row in mine.items() if picture in ours]
    return found | {"psnr_error": standard_error(apart) or 0.0}


def every_setting(megapixels: float, method: str) -> list[dict[str, float]]:
    """Means of each setting of a method, in the order in which they were measured."""
    settings = dict.fromkeys(row["setting"] for row in rows(SIZES[megapixels]) if row["method"] == method)
    return [m for setting in settings if (m := at(megapixels, method, setting))]


def costs_table(megapixels: float) -> str:
    """A line for each method at one size, the quickest first: seconds with the search for a size, and of one encode of
    another codec; quality, bytes, and memory where it was measured. Means over the pictures."""
    found = {name: m for key, name in COSTS.items() if (m := at(megapixels, *key))}
    titles = "method | with its search, s | one encode, s | PSNR, dB | SSIMULACRA 2 | bytes"
    has_memory = all("mib" in m for m in found.values())
    lines = []
    for name, m in sorted(found.items(), key=lambda item: item[1]["seconds"]):
        times = seconds(m["seconds"]), seconds(m["encode_s"]) if "encode_s" in m else MISSING
        memory = [number(m["mib"], ",.0f")] if has_memory else []
        lines.append([name, *times, f"{m['psnr']:.1f}", f"{m['ssimulacra2']:.1f}", f"{m['bytes']:,.0f}", *memory])
    return table(titles + " | memory, MiB" * has_memory, lines)


def until() -> str:
    """A line for each size and figure: seconds until AVIF's quality at AVIF's bytes, on one core."""
    return until_table([row for name in ONE_CORE for row in rows(name)])


def growth(axis: str) -> str:
    """Seconds along the pixels or the bytes."""
    return growth_table(rows("growth"), load("growth")["settings"], axis)


def figures() -> dict[str, float]:
    """The figures of sentences, by mark."""
    found: dict[str, float] = {}
    for size in SIZES:
        end = f"{size:g}mp"
        ours, visual, avif = at(size, "rd", ""), at(size, "rd visual", ""), at(size, "avif", "6")
        assert ours and visual and avif
        found[f"speed.times-avif-{end}"] = ours["seconds"] / avif["seconds"]
        found[f"speed.times-avif-once-{end}"] = ours["seconds"] / avif["encode_s"]
        found[f"speed.gain-{end}"] = ours["psnr"] - avif["psnr"]
        found[f"speed.gain-error-{end}"] = avif["psnr_error"]
        found[f"speed.avif-{end}"], found[f"speed.avif-once-{end}"] = avif["seconds"], avif["encode_s"]
        found[f"speed.rd-{end}"], found[f"speed.decode-{end}"] = visual["seconds"], visual["decode_ms"]
        eye = {"rd": visual, "fidelity": at(size, "rd fidelity", ""), "avif-visual": at(size, "avif visual", "6")}
        for name, one in eye.items():
            found[f"speed.{name}-ssimulacra2-{end}"] = one["ssimulacra2"] if one else math.nan
            found[f"speed.{name}-seconds-{end}"] = one["seconds"] if one else math.nan
        for name, other in (("jpeg", at(size, "jpeg", "0")), ("avif", avif)):
            assert other
            found[f"speed.times-{name}-decode-{end}"] = visual["decode_ms"] / other["decode_ms"]
    for name, setting in (("avif", "4"), ("jpegxl", "7"), ("webp", "6")):
        once = at(0.4, name, setting)
        found[f"speed.{name}-{setting}-once-ms"] = 1e3 * once["encode_s"] if once else math.nan
    return found | growing()


def growing() -> dict[str, float]:
    """Seconds of photographs of a camera, by mark: method, megapixels and bytes."""
    groups: dict[str, list[float]] = {}
    for row in rows("growth"):
        method = f"{row['method']} {row['setting']}".strip().replace(" ", "-")
        groups.setdefault(f"growth.{method}-{row['megapixels']:g}mp-{row['max_bytes']}", []).append(row["seconds"])
    found = {mark: statistics.fmean(values) for mark, values in groups.items()}
    found["growth.times"] = found["growth.rd-visual-12mp-10000"] / found["growth.rd-visual-0.75mp-10000"]
    return found


def draw(axes: Any, megapixels: float) -> None:
    """PSNR against seconds at one size."""
    lows = []
    for k, method in enumerate(DRAWN):
        points = sorted((m["seconds"], m["psnr"], m["psnr_error"]) for m in every_setting(megapixels, method))
        if not points:
            continue
        look = {"linestyle": "none"} if method in ("webp", "jpeg") else {}
        seconds_, db, error = zip(*points, strict=True)
        axes.errorbar(seconds_, db, error, **style(k) | look | {"label": LABELS.get(method, method)})
        lows.append(max(db))
    label = f"seconds, {megapixels:g} megapixels"
    axes.set(xscale="log", xlabel=label, ylabel="PSNR, dB", ylim=(math.floor(min(lows)) - 4, None))
