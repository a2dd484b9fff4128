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
from benchmarks.report.results import Row, load, rows
from benchmarks.tables import MISSING, number, standard_error, table

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
QUOTED = ("lpips", "dists", "psnr")
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


def quoted_table() -> str:
    """Our files of Kodak beside codecs whose decoders are networks, as published: at the rate nearest to ours."""
    ours = means(rows("perceptual/kodak"), BPP)["visual"]
    _, timed = _of_both_pages()
    took = {name: statistics.fmean(row[name] for row in timed) for name in ("encode_s", "decode_ms")}
    times = [f"{1e3 * took['encode_s']:,.0f} ms", f"{took['decode_ms']:.1f} ms"]
    found = [["ours, tuned for the eye", f"{BPP:g}", *(number(ours[name], FORMS[name]) for name in QUOTED), *times]]
    for name, codec in published.seen().items():
        point = nearest(codec)
        times = [f"{codec[one]} ms" if one in codec else MISSING for one in ("encode_ms", "decode_ms")]
        figures = [number(point.get(figure), FORMS[figure]) for figure in QUOTED]
        found.append([f"{name} (quoted)", f"{point['bpp']:.3g}", *figures, *times])
    titles = ["codec", "bpp", *(TITLES[name] for name in QUOTED), "encode, on a CPU", "decode, on a CPU"]
    return table(" | ".join(titles), found)


def nearest(codec: Row) -> Row:
    """The published point whose rate is nearest to ours."""
    point: Row = min(codec["points"], key=lambda point: abs(point["bpp"] - BPP))
    return point


def same_encoder() -> str:
    """A sentence: how many of Kodak's files are those of the page of rates, which others measured again."""
    both = [{r["image"]: (r["bytes"], round(r["psnr"], 3)) for r in found} for found in _of_both_pages()]
    same = sum(both[0].get(image) == file for image, file in both[1].items())
    dates = {name: load(name)["date"] for name in ("perceptual/kodak", "rd/kodak")}
    which = "this page" if dates["perceptual/kodak"] < dates["rd/kodak"] else "[rate](rate.md)"
    older = "" if same == len(both[1]) else f"; {which} was measured with an earlier commit of the encoder"
    return f"{same} of Kodak's {len(both[1])} files tuned for the eye are those of [rate](rate.md){older}."


def _of_both_pages() -> tuple[list[Row], list[Row]]:
    """The rows of our files tuned for the eye, of this page and of the page of rates."""
    mine = [row for row in rows("perceptual/kodak") if (row["kind"], row["max_bpp"]) == ("visual", BPP)]
    return mine, [row for row in rows("rd/kodak") if (row["codec"], row["max_bpp"]) == ("rd visual", BPP)]


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
    return found


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
