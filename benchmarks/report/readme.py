"""The README's figures, between marks: <!-- table NAME --> and <!-- end -->."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.rd.report import against_quoted, means
from benchmarks.report import rate
from benchmarks.report.section import Content, load, mean, number, seconds, several, table

WIDTH = 120  # of a line
BPP = 0.25
KODAK_MEGAPIXELS = 0.4
SIZES = (10_000, 50_000)  # bytes of a file
MARKED = r"( *)<!-- table {} -->\n.*?<!-- end -->"

# Columns: the codec tuned for PSNR, and for the eye; they differ only where a codec can be tuned.
CODECS = {
    "sgmethod": ("rd", "rd visual"),
    "AVIF": (rate.AVIF, rate.AVIF_FOR_EYES),
    "JPEG XL": ("jpegxl", "jpegxl"),
    "WebP": ("webp", "webp"),
    "JPEG": ("jpeg", "jpeg"),
}
# Rows: column of the JSON, its format, whether more is better (None: neither), which of the two codecs is measured, and
# a factor.
ROWS = {
    "PSNR, dB ↑": ("psnr", ".1f", True, 0, 1),
    "LPIPS ↓": ("lpips", ".2f", False, 1, 1),
    "SSIMULACRA 2 ↑": ("ssimulacra2", ".0f", True, 1, 1),
    "Decoding, ms ↓": ("decode_ms", ".1f", False, 1, 1),
    "Encoding, ms ↓": ("encode_s", ",.0f", False, 1, 1000),
    "Size, kB": ("bytes", ".1f", None, 1, 1e-3),
}
LIBRARIES = ("libavif-", "libjxl-", "libwebp-", "libjpeg_turbo-")
# Published codecs that the README names, with what their readers know them by.
RIVALS = {"VTM": "VTM (H.266)", "ELIC": "ELIC", "Cool-Chic 5.0": "Cool-Chic 5.0"}


def filled(text: str, results: Path) -> str:
    """The README with its figures as the JSON has them. Raises SystemExit where marks are missing."""
    makers: dict[str, Callable[[Path], str]] = {"figures": figures, "slow": slow, "ahead": ahead}
    for name, make in makers.items():
        made = f"<!-- table {name} -->\n{make(results)}\n"
        found = re.compile(MARKED.format(name), re.DOTALL)
        text, count = found.subn(lambda m, made=made: f"{m[1]}{made}{m[1]}<!-- end -->", text)  # type: ignore[misc]
        if count != 1:
            raise SystemExit(f"the README has {count} tables {name}, and not one")
    return text


def bullet(title: str, text: str) -> str:
    """One point of a list, broken into lines."""
    return textwrap.fill(
        f"- **{title}** {text}", WIDTH, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )


def figures(results: Path) -> str:
    """What the codec wins and loses at 0.25 bits per pixel; the best of each row is bold."""
    loaded = [load(results, name) or {"rows": []} for name in ("rd/kodak", "rd/avif")]
    average = means(rate.rows_of(*loaded))
    lines = []
    for title, (name, form, more, tuned, factor) in ROWS.items():
        values = [average.get((codecs[tuned], BPP), {}).get(name) for codecs in CODECS.values()]
        known = [value for value in values if value is not None]
        best = None if more is None else (max if more else min)(known, default=None)
        cells = [number(value if value is None else value * factor, form) for value in values]
        lines.append(
            [title, *(f"**{c}**" if v is not None and v == best else c for c, v in zip(cells, values, strict=True))]
        )
    made = table(" | ".join(["", *CODECS]), lines)
    ours, grain = (average.get((codec, BPP), {}) for codec in ("rd visual", "avif grain"))
    notes = []
    if (told := rate.at_our_size(average)) is not None:
        notes.append(told)
    if ours.get("dists") and grain.get("dists"):
        notes.append(
            f"With film grain switched on, AVIF reaches an LPIPS of {number(grain['lpips'], '.2f')} and has a "
            f"better DISTS, a similar measure: {number(grain['dists'], '.3f')} against {number(ours['dists'], '.3f')}."
        )
    if (told := avif_threads(load(results, "speed"))) is not None:
        notes.append(told)
    change = against_quoted(average, "rd", rate.ANCHOR)
    if change is not None and change < 0:
        times = f"{100 / (100 + change):.0f} times"
        notes.append(f"At the same PSNR, {rate.ANCHOR} needs {times} our bits, by its published figures.")
    notes.append(f"Measured with {versions(results)}.")
    return f"{made}\n\n{textwrap.fill(' '.join(notes), WIDTH, break_long_words=False, break_on_hyphens=False)}"


def avif_threads(speed: Content | None) -> str | None:
    """What AVIF's decoder gains by a second thread, in a sentence; the rows of rates were measured without."""
    sizes = [row for row in (speed or {"rows": []})["rows"] if row.get("megapixels") == KODAK_MEGAPIXELS]
    if not sizes or "avif" not in sizes[0].get("rivals_decode_ms", {}):
        return None
    return f"AVIF is decoded by one thread here; by two, it takes {sizes[0]['rivals_decode_ms']['avif']:.1f} ms."


def versions(results: Path) -> str:
    """The libraries behind the other columns, such as "libwebp 1.6.0"."""
    named = (load(results, "rd/kodak") or {"settings": {"codecs": []}})["settings"]["codecs"]
    # The last libavif, Pillow's, is the one that made these files.
    found = dict(re.split("[-/ ]", name)[:2] for name in named if name.startswith(LIBRARIES))
    return several([f"{library.replace('_', '-')} {version}" for library, version in sorted(found.items())])


def slow(results: Path) -> str:
    """How long an encode of a large picture takes, beside AVIF."""
    rows = (load(results, "growth") or {"rows": []})["rows"]
    largest = max((row["megapixels"] for row in rows), default=0)

    def of(method: str, setting: str, size: int) -> list[dict[str, Any]]:
        key = (method, setting, largest, size)
        return [r for r in rows if (r["method"], r["setting"], r["megapixels"], r["max_bytes"]) == key]

    def taken(found: list[dict[str, Any]]) -> str:
        return seconds(mean([row["seconds"] for row in found]))

    def avif(size: int) -> str:
        found = of("avif", "6", size)
        if all(row["bytes"] <= size for row in found):
            return taken(found)
        return f"{taken(of('avif reduced', '6', size))} (of a reduced picture, as none of its files is so small)"

    return bullet(
        "Fast encoding:",
        f"AVIF. From a picture of {largest:g} megapixels, a file of {SIZES[0]:,} bytes takes "
        f"{taken(of('rd visual', '', SIZES[0]))} seconds and one of {SIZES[1]:,} bytes "
        f"{taken(of('rd visual', '', SIZES[1]))}; AVIF at speed 6 takes {avif(SIZES[0])} and {avif(SIZES[1])}. "
        f"{whole(results)}`--effort 1` "
        "is faster, at lower quality.",
    )


def whole(results: Path) -> str:
    """How long it takes at BPP, in a sentence."""
    rows = (load(results, "convergence/12-megapixels") or {"rows": []})["rows"]
    ours, avif = (
        mean([row["seconds"] for row in rows if (row["method"], row["setting"]) == which])
        for which in (("rd visual", ""), ("avif", "6"))
    )
    return (
        f"A mosaic of that size takes {seconds(ours)} seconds at {BPP} bits per pixel, and {seconds(avif)} with AVIF. "
    )


def ahead(results: Path) -> str:
    """The published codecs that are ahead in PSNR."""
    found = rate.ahead(rate.rows_of(load(results, "rd/kodak") or {"rows": []}), load(results, "rd/quality"))
    told = [f"{found[name]:.0f} % more than {told_as}" for name, told_as in RIVALS.items() if found.get(name, 0) > 0]
    if not told:
        return ""
    return bullet(
        "The highest PSNR, at any cost:",
        "VTM or a learned codec. At the same PSNR, `--tune psnr` needs "
        f"{several(told).replace('more', 'more bits', 1)}, by their published figures.",
    )
