"""Quality of a fixed number of Gaussians in floating point, before any is coded: the paper's tables of representation.

    python -m benchmarks.ablation representation --images FOLDER [--most 6] [--pictures kodim05]
                                                 [--gaussians 5000,10000,30000,70000] [--methods paper,...]
                                                 [--weights FOLDER]

rd, paper: the profile's fit. --weights: a folder as benchmarks.perceptual takes it, for LPIPS. Seconds are those of the
fit with its start, frames those of drawing at full size; MiB is the peak of the fit's process, of which Python and
torch alone take about 250. A picture of 0.4 megapixels takes a quarter of an hour.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.ablation.fits import measured
from benchmarks.ablation.report import FIGURES, REPRESENTATIONS, representations
from benchmarks.arguments import integers, some_of
from benchmarks.machine import RUNS, Record
from benchmarks.perceptual.networks import Networks
from benchmarks.pictures import add_options, named_in
from benchmarks.speed.sizes import alone
from benchmarks.tables import number, table
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import ms_ssim, psnr


def measure(method: str, path: Path, gaussians: int, steps: int, seen: Networks | None) -> dict[str, Any]:
    """One fit in a process of its own; this one compares what it shows."""
    row = alone(measured, method, path, gaussians, steps)
    shown, pixels = row.pop("shown"), read_image_8_bit(path.read_bytes())
    quality = {"psnr": psnr(shown, pixels), "ms_ssim": ms_ssim(shown, pixels)}
    return {**quality, "lpips": seen.lpips(shown, pixels) if seen else None, **row}


def summary(rows: Sequence[dict[str, Any]]) -> str:
    """A table of means over the pictures."""
    lines = []
    for asked in sorted({row["asked"] for row in rows}):
        for method, figures in representations(rows, asked).items():
            cells = [number(figures[name], form) for name, form in FIGURES.items()]
            lines.append([f"{asked:,}", method, figures["pictures"], *cells])
    titles = "PSNR | MS-SSIM | LPIPS | seconds | frames a second | MiB"
    return table(f"Gaussians | method | pictures | {titles}", lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.ablation representation",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_options(parser, most=6)
    parser.add_argument("--gaussians", type=integers, default="5000,10000,30000,70000", help="numbers, with commas")
    parser.add_argument("--steps", type=int, default=3000, help="of every fit of Gaussians")
    every = ",".join(REPRESENTATIONS)
    parser.add_argument("--methods", type=some_of(REPRESENTATIONS, "method"), default=every, help="those measured")
    parser.add_argument("--weights", type=Path)
    parser.add_argument("--out", type=Path, default=RUNS / "representation.json")
    options = parser.parse_args()
    methods = [method for method in REPRESENTATIONS if method in options.methods]
    seen = Networks(options.weights) if options.weights else None
    settings = {"steps": options.steps, "lpips": seen is not None}
    record = Record(options.out, "benchmarks.ablation representation", settings)
    for path in named_in(options):
        for asked in options.gaussians:
            for method in methods:
                key = {"method": method, "asked": asked, "image": path.name}
                if not record.has(**key):
                    record.add({**key, **measure(method, path, asked, options.steps, seen)})
    print(f"\n{summary(record.rows)}")
