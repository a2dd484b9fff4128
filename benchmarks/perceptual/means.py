"""Means of what people see, by rate and kind, beside AVIF's."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence
from typing import Any

from benchmarks.perceptual import local
from benchmarks.rd.report import TITLES as NAMES
from benchmarks.tables import number

NAMES = NAMES | {"wasserstein": "Wasserstein"} | {name: name.replace("_", ", ") for name in local.FIGURES}
WHOLE = ("psnr", "ms_ssim", "ssimulacra2", "lpips", "dists", "wasserstein")
FIGURES = (*WHOLE, *local.FIGURES)
BETTER_IF_LOWER = ("lpips", "dists", "wasserstein")
OURS = ("psnr", "visual")
RIVALS = ("avif", "avif grain", "avif tune=ssimulacra2", "jpegxl")
KINDS = (*OURS, *RIVALS)
TITLES = " | ".join(["bpp at most", "pictures", "file", "bytes", "texture", *(NAMES[name] for name in FIGURES)])
Row = dict[str, Any]


def means(rows: Sequence[Row], bpp: float) -> dict[str, Row]:
    """By kind, over the pictures that AVIF has too; with the number of pictures. A kind that lacks some of these is
    left out. A figure is None where no row has it, and else the mean of those that do."""
    mine = [row for row in rows if row["max_bpp"] == bpp]
    there = {row["image"] for row in mine if row["kind"] == "avif"}
    found: dict[str, Row] = {}
    for kind in KINDS:
        these = [row for row in mine if row["kind"] == kind and (row["image"] in there or not there)]
        if these and len(these) >= len(there):
            values = {name: [row[name] for row in these if row.get(name) is not None] for name in FIGURES}
            found[kind] = {name: statistics.fmean(known) if known else None for name, known in values.items()}
            found[kind] |= {name: statistics.fmean(row[name] for row in these) for name in ("bytes", "texture")}
            found[kind]["pictures"] = len(these)
    return found


def lines(rows: Sequence[Row]) -> Iterator[list[str]]:
    """Of a table with TITLES; in brackets against AVIF: a ratio of what is better if lower, else a difference."""
    for bpp in rates(rows):
        found = means(rows, bpp)
        for kind, mean in found.items():
            cells = [number(mean[name], ".3f") + against(name, mean, found.get("avif")) for name in FIGURES]
            yield [f"{bpp:g}", f"{mean['pictures']:g}", kind, f"{mean['bytes']:,.0f}", f"{mean['texture']:.2%}", *cells]


def rates(rows: Sequence[Row]) -> list[float]:
    """Bits per pixel at most, from the lowest."""
    return sorted({row["max_bpp"] for row in rows})


def against(name: str, mean: Row, avif: Row | None) -> str:
    """How a mean compares with AVIF's."""
    if avif is None or mean is avif or name in local.FIGURES or None in (mean[name], avif[name]):
        return ""
    return f" ({mean[name] / avif[name]:.2f})" if name in BETTER_IF_LOWER else f" ({mean[name] - avif[name]:+.3f})"


def worse(rows: Sequence[Row], bpp: float) -> tuple[int, int]:
    """In how many pictures ours, tuned for the eye, is behind AVIF in SSIMULACRA 2, and of how many."""
    found = {(row["image"], row["kind"]): row["ssimulacra2"] for row in rows if row["max_bpp"] == bpp}
    both = [image for image, kind in found if kind == "visual" and (image, "avif") in found]
    return sum(found[image, "visual"] < found[image, "avif"] for image in both), len(both)
