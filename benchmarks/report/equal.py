"""Codecs at equal bytes, each setting in a row of its own: no row mixes the files of two."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

from benchmarks.machine import RESULTS
from benchmarks.rd.equal import FORMS, Difference, cells, difference
from benchmarks.rd.report import QUALITIES, TITLES, Means, Row, against, means
from benchmarks.report import results
from benchmarks.tables import number, table

# The JSON of each set of photographs, of which no two have the same row.
FILES = {
    "768": ("rd/equal-768",),
    "whole": ("rd/equal-whole", "rd/equal-whole-eye", "rd/equal-whole-psnr"),
    "kodak": ("rd/equal-kodak",),
}
# Codec and setting of a row, and the names of its files. Where AVIF was made in 8 and in 10 bits, a row has those bits
# that are better in the figure that the setting is for.
CODECS: dict[tuple[str, str], tuple[str, ...]] = {
    ("sgmethod", "psnr"): ("rd",),
    ("sgmethod", "fidelity"): ("rd fidelity",),
    ("sgmethod", "visual"): ("rd visual",),
    ("sgmethod", "visual, no texture"): ("rd visual without texture",),
    ("AVIF", "psnr"): ("avif tune=psnr", "avif tune=psnr 10 bits"),
    ("AVIF", "iq"): ("avif tune=iq 4:4:4", "avif tune=iq 10 bits"),
    ("AVIF", "ssimulacra2"): ("avif tune=ssimulacra2",),
    ("AVIF", "iq, film grain"): ("avif grain",),
    ("JPEG XL", "effort 7"): ("jpegxl",),
    ("WebP", "method 6"): ("webp",),
    ("jpegli", "4:2:0"): ("jpegli",),
}
# Settings that aim at the same, ours and theirs.
PAIRS = (
    ("psnr", "psnr"),
    ("fidelity", "ssimulacra2"),
    ("visual, no texture", "iq"),
    ("visual", "iq"),
    ("visual", "iq, film grain"),
)


@cache
def rows(size: str) -> tuple[Row, ...]:
    """The rows of one of FILES."""
    return tuple(Row(**row) for name in FILES[size] for row in results.rows(name))


@cache
def average(size: str) -> Means:
    """Their means over pictures."""
    return means(rows(size))


def rates(size: str) -> list[float]:
    """The rates that were measured, in order."""
    return sorted({bpp for _, bpp in average(size)})


def file_of(size: str, codec: tuple[str, str], bpp: float) -> str | None:
    """The name of a row's files; None where none was made."""
    found = average(size)
    figure = "psnr" if codec[1] == "psnr" else "ssimulacra2"
    names = [name for name in CODECS[codec] if (name, bpp) in found]
    return max(names, key=lambda name: found[name, bpp][figure] or 0, default=None)


def means_table(size: str) -> str:
    """A row for each rate, codec and setting."""
    lines = []
    for bpp in rates(size):
        for codec in CODECS:
            if name := file_of(size, codec, bpp):
                m = average(size)[name, bpp]
                bits = f"{codec[1]}, 10 bits" if name.endswith("10 bits") else codec[1]
                above = f" (larger on {m['above']:g} of {m['images']:g})" if m["above"] else ""
                lines.append([f"{bpp:g}", codec[0], bits + above, *(number(m[q], FORMS[q]) for q in QUALITIES)])
    return table(" | ".join(["bpp", "codec", "setting", *(TITLES[q] for q in QUALITIES)]), lines)


def differences(size: str) -> Iterator[tuple[float, str, str, str, Difference]]:
    """Rate, our setting, AVIF's that aims at the same, figure, and ours less AVIF's picture by picture."""
    for bpp in rates(size):
        for ours, theirs in PAIRS:
            names = file_of(size, ("sgmethod", ours), bpp), file_of(size, ("AVIF", theirs), bpp)
            if None in names:
                continue
            for figure in QUALITIES:
                if found := difference(rows(size), str(names[0]), str(names[1]), bpp, figure):
                    yield bpp, ours, theirs, figure, found


def differences_table(size: str) -> str:
    """A row for each rate and pair of settings, a column for each figure."""
    by_pair: dict[tuple[float, str, str], dict[str, Difference]] = {}
    for bpp, ours, theirs, figure, found in differences(size):
        by_pair.setdefault((bpp, ours, theirs), {})[figure] = found
    measured = [figure for figure in QUALITIES if any(figure in found for found in by_pair.values())]
    lines = [
        [f"{bpp:g}", *settings, *(gain(found[figure], FORMS[figure]) if figure in found else "" for figure in measured)]
        for (bpp, *settings), found in by_pair.items()
    ]
    return table(" | ".join(["bpp", "sgmethod", "AVIF", *(TITLES[figure] for figure in measured)]), lines)


def gain(found: Difference, form: str) -> str:
    """The difference with its standard error, and on how many pictures ours is better."""
    _, _, difference, better = cells(found, form)
    return f"{difference} ({better})"


def figures() -> dict[str, float | None]:
    """The differences and their standard errors, and the bits that AVIF saves us or we save at equal PSNR."""
    found: dict[str, float | None] = {}
    for size in measured():
        for bpp, ours, theirs, figure, one in differences(size):
            settings = f"{ours}-{theirs}".replace(",", "").replace(" ", "-")
            mark = f"equal.{size}-{settings}-{figure}-at-{bpp:g}"
            found |= {mark: one.gain, f"{mark}-error": one.standard_error, f"{mark}-behind": -one.gain}
            found[f"equal.{size}-pictures"] = one.pictures
        if rate := against(rows(size), "rd", "avif tune=psnr 10 bits"):
            found |= {f"equal.{size}-fewer": -rate.mean, f"equal.{size}-fewer-error": rate.standard_error}
    return found


def measured() -> list[str]:
    """Those of FILES that have been measured."""
    return [size for size, names in FILES.items() if all((RESULTS / f"{name}.json").exists() for name in names)]
