"""Metrics that are designed to agree with people, compared with AVIF at the same size."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from typing import Any

from benchmarks import published
from benchmarks.perceptual import local
from benchmarks.rd.report import TITLES
from benchmarks.report.plots import style
from benchmarks.report.results import Row, rows
from benchmarks.tables import number, standard_error, table

SETS = {"kodak": "Kodak", "photographs": "other photographs"}
KINDS = {"visual": "tuned for the eye", "avif": "AVIF, `tune=iq`"}
TITLES = TITLES | {
    "bytes": "bytes",
    "wasserstein": "Wasserstein Distortion",
    "spread_luma_fine": "spread kept",
    "kurtosis_luma_fine": "kurtosis",
}
TITLES |= {name: " ".join(reversed(name.split("_"))) for name in local.FIGURES if name not in TITLES}
FORMS = {"bytes": ",.0f", "psnr": ".2f", "ssimulacra2": ".1f", "wasserstein": ".2f"}
FORMS |= {"lpips": ".3f", "dists": ".3f"} | dict.fromkeys(local.FIGURES, ".2f")
TABLE = ("bytes", "psnr", "ssimulacra2", "lpips", "dists", "wasserstein", "spread_luma_fine", "kurtosis_luma_fine")
BPP = 0.25
BETTER_IF_LOWER = ("lpips", "dists", "wasserstein")


def means(rows: Sequence[Row], bpp: float) -> dict[str, Row]:
    """Means by kind of file, over the pictures that have both."""
    mine = [row for row in rows if row["max_bpp"] == bpp]
    there = {row["image"] for row in mine if row["kind"] == "avif"}
    found: dict[str, Row] = {}
    for kind in KINDS:
        these = [row for row in mine if row["kind"] == kind and row["image"] in there]
        known = {name: [row[name] for row in these if row[name] is not None] for name in ("texture", *FORMS)}
        found[kind] = {name: statistics.fmean(values) for name, values in known.items()}
    return found


def apart(rows: Sequence[Row], figure: str) -> list[float]:
    """A figure of our files less that of AVIF's, picture by picture."""
    found = {(row["image"], row["kind"]): row[figure] for row in rows if row["max_bpp"] == BPP}
    both = [image for image, kind in found if kind == "visual" and (image, "avif") in found]
    return [found[image, "visual"] - found[image, "avif"] for image in both]


def means_table(wanted: Sequence[str] = TABLE) -> str:
    """Means of each set and kind of files."""
    lines = []
    for name, title in SETS.items():
        found = means(rows(f"perceptual/{name}"), BPP)
        for kind, words in KINDS.items():
            lines.append([title, words, *(number(found[kind][figure], FORMS[figure]) for figure in wanted)])
    return table(" | ".join(["pictures", "file", *(TITLES[figure] for figure in wanted)]), lines)


def figures() -> dict[str, float]:
    """The figures of sentences, by mark."""
    found: dict[str, float] = {}
    for name in SETS:
        mine = rows(f"perceptual/{name}")
        ours, avif = (means(mine, BPP)[kind] for kind in KINDS)
        found |= {f"seen.{name}-{figure}": ours[figure] / avif[figure] for figure in BETTER_IF_LOWER}
        found[f"seen.{name}-points-higher"] = ours["ssimulacra2"] - avif["ssimulacra2"]
        found[f"seen.{name}-points-lower"] = avif["ssimulacra2"] - ours["ssimulacra2"]
        points = apart(mine, "ssimulacra2")
        found[f"seen.{name}-points-error"] = standard_error(points) or math.nan
        found[f"seen.{name}-lower"], found[f"seen.{name}-pictures"] = sum(one < 0 for one in points), len(points)
        for figure in BETTER_IF_LOWER:
            found[f"seen.{name}-better-{figure}"] = sum(one < 0 for one in apart(mine, figure))
        found[f"seen.{name}-texture"] = 100 * ours["texture"]
    crdr = min(published.seen()["points"], key=lambda point: abs(point["bpp"] - BPP))
    return found | {f"seen.crdr-{figure}": crdr[figure] for figure in ("bpp", "psnr", "lpips", "dists")}


def draw(axes: Any, figure: str) -> None:
    """One figure of AVIF's files against that of ours, picture by picture, on axes from bad to good."""
    for k, (name, title) in enumerate(SETS.items()):
        mine = [row for row in rows(f"perceptual/{name}") if row["max_bpp"] == BPP]
        ours, avif = ({r["image"]: r[figure] for r in mine if r["kind"] == kind} for kind in KINDS)
        both = [(ours[image], avif[image]) for image in ours if image in avif]
        axes.plot(*zip(*both, strict=True), **style(k) | {"linestyle": "none", "label": title})
    ends = min(axes.get_xlim()[0], axes.get_ylim()[0]), max(axes.get_xlim()[1], axes.get_ylim()[1])
    good_last = ends if figure == "ssimulacra2" else ends[::-1]
    axes.plot(ends, ends, color="0.6", linewidth=0.8)
    axes.set(xlim=good_last, ylim=good_last, xlabel=f"{TITLES[figure]} of ours, better to the right", ylabel="of AVIF")
