"""Means of metrics that follow the eye, over the pictures that AVIF can make small enough too."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import Any

from benchmarks.perceptual import local

FIGURES = ("bytes", "texture", "psnr", "ms_ssim", "ssimulacra2", "lpips", "dists", "wasserstein", *local.FIGURES)
BETTER_IF_LOWER = ("lpips", "dists", "wasserstein")
Row = dict[str, Any]


def means(rows: Sequence[Row], bpp: float) -> dict[str, Row]:
    """Means of FIGURES by kind of file, visual and avif, over the pictures that have both."""
    mine = [row for row in rows if row["max_bpp"] == bpp]
    there = {row["image"] for row in mine if row["kind"] == "avif"}
    found: dict[str, Row] = {}
    for kind in ("visual", "avif"):
        these = [row for row in mine if row["kind"] == kind and row["image"] in there]
        known = {name: [row[name] for row in these if row[name] is not None] for name in FIGURES}
        found[kind] = {name: statistics.fmean(values) for name, values in known.items()}
    return found


def worse(rows: Sequence[Row], bpp: float) -> tuple[int, int]:
    """In how many pictures our file is behind AVIF's in SSIMULACRA 2, and of how many."""
    found = {(row["image"], row["kind"]): row["ssimulacra2"] for row in rows if row["max_bpp"] == bpp}
    both = [image for image, kind in found if kind == "visual" and (image, "avif") in found]
    return sum(found[image, "visual"] < found[image, "avif"] for image in both), len(both)
