"""What people see, over a folder of pictures: python -m benchmarks.perceptual --images FOLDER --weights FOLDER

For each picture and rate: a file tuned for PSNR, one tuned for the eye, the latter decoded without its texture, and
AVIF (imagecodecs, speed 4, 4:2:0, tune=iq, which is libavif's own) at the best quality that takes no more bytes. A
picture that AVIF cannot make so small is left out of the means. What the JSON already holds for the same commit and
machine is not done again. Needs the packages imagecodecs and ssimulacra2, and weights (see metrics.py).
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import RESULTS, in_words, kept_rows, origin, write_json
from benchmarks.perceptual.metrics import BETTER_IF_LOWER, Metrics, Pixels
from benchmarks.pictures import pictures_in
from benchmarks.rd.codecs import Avif
from sgmethod import decode, encode, info
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import MIN_SIDE

FIGURES = ("psnr", "ms_ssim", "ssimulacra2", "lpips", "dists")
KINDS = ("psnr", "visual", "visual, no texture", "avif")
Row = dict[str, Any]


def decoded(pixels: Pixels, bpp: float, kinds: Sequence[str]) -> Iterator[tuple[str, int, float, Pixels]]:
    """Kind, bytes, the part of them that is texture, pixels; of the kinds that are wanted."""
    visual = encode(pixels, bpp=bpp, tune="visual").data
    if "psnr" in kinds:
        data = encode(pixels, bpp=bpp, tune="psnr").data
        yield "psnr", len(data), 0.0, decode(data)
    if "visual" in kinds:
        yield "visual", len(visual), info(visual).bits["texture"] / (8 * len(visual)), decode(visual)
    if "visual, no texture" in kinds:
        yield "visual, no texture", len(visual), 0.0, decode(visual, texture=False)
    if "avif" in kinds:
        avif = Avif().run(pixels, 8 * len(visual) / (pixels.shape[0] * pixels.shape[1]))
        if len(avif.data) <= len(visual):
            yield "avif", len(avif.data), 0.0, avif.decode(avif.data)


def table(rows: list[Row]) -> str:
    """Means by rate and kind, over the pictures that AVIF has too; in brackets against AVIF, as a difference, or as a
    ratio of what is better if lower."""
    lines = [f"| bpp | | bytes | texture | {' | '.join(FIGURES)} |", "|---" * (4 + len(FIGURES)) + "|"]
    for bpp in sorted({row["max_bpp"] for row in rows}):
        there = {row["image"] for row in rows if (row["max_bpp"], row["kind"]) == (bpp, "avif")}
        shown = [row for row in rows if row["max_bpp"] == bpp and (row["image"] in there or not there)]
        means = {
            kind: {
                name: statistics.fmean(row[name] for row in shown if row["kind"] == kind)
                for name in ("bytes", "texture", *FIGURES)
            }
            for kind in KINDS
            if any(row["kind"] == kind for row in shown)
        }
        for kind, mean in means.items():
            cells = [f"{mean[name]:.3f}{against(name, mean, means.get('avif'))}" for name in FIGURES]
            lines.append(f"| {bpp:g} | {kind} | {mean['bytes']:,.0f} | {mean['texture']:.2%} | {' | '.join(cells)} |")
    return "\n".join(lines)


def against(name: str, mean: Row, avif: Row | None) -> str:
    """How a mean compares with AVIF's."""
    if avif is None or mean is avif:
        return ""
    return f" ({mean[name] / avif[name]:.2f})" if name in BETTER_IF_LOWER else f" ({mean[name] - avif[name]:+.3f})"


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.perceptual", description="What people see, in figures.")
    parser.add_argument("--images", type=Path, required=True, help="folder of pictures")
    parser.add_argument("--weights", type=Path, required=True, help="folder of the networks' weights")
    parser.add_argument("--bpp", default="0.1,0.25", help="rates, each an upper limit for every file")
    parser.add_argument(
        "--kinds", nargs="+", choices=KINDS, default=KINDS, help="some of them: networks take their time"
    )
    parser.add_argument("--out", type=Path, default=RESULTS / "perceptual.json")
    options = parser.parse_args()
    paths = pictures_in(options.images)
    if not paths:
        parser.error(f"there is no picture in {options.images}")
    metrics, where = Metrics(options.weights), origin()
    rows: list[Row] = kept_rows(options.out, where)
    done = {(row["image"], row["max_bpp"]) for row in rows}
    for path in paths:
        pixels = np.ascontiguousarray(read_image_8_bit(path.read_bytes()))
        if min(pixels.shape[:2]) < MIN_SIDE:
            parser.error(f"{path} has a side below {MIN_SIDE} pixels, for which MS-SSIM is not defined")
        for bpp in map(float, options.bpp.split(",")):
            if (path.name, bpp) in done:
                continue
            for kind, size, texture, picture in decoded(pixels, bpp, options.kinds):
                row = {"image": path.name, "max_bpp": bpp, "kind": kind, "bytes": size, "texture": round(texture, 5)}
                rows.append({**row, **{name: round(v, 4) for name, v in metrics(picture, pixels).items()}})
                print(*rows[-1].values(), file=sys.stderr)
            write_json(options.out, {**where, "rows": rows})
    print(table(rows), in_words(where), sep="\n\n")


if __name__ == "__main__":
    main()
