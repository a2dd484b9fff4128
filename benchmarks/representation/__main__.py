"""Quality of a fixed number of Gaussians in floating point, before any is coded: the paper's tables of representation.

    python -m benchmarks.representation --images FOLDER [--most 6] [--pictures kodim05]
                                        [--gaussians 5000,10000,30000,70000] [--methods rd,paper,...] [--weights FOLDER]

rd: profile rd's fit. paper: profile paper's, from a structure-guided start and with geometry-consistent regularisation;
unregularised and random-start: one of these left out; baseline: both, which is GSImage's start and loss with our
optimiser. siren, wire: networks of as many numbers (8 for each Gaussian asked for), fitted for as many seconds as rd
took, which must be measured before. --weights: a folder as benchmarks.perceptual takes it, for LPIPS.

Seconds are those of the fit with its start, frames those of drawing at full size, both on this machine's cores. MiB is
the peak of the fit's process, of which Python and torch alone take about 250. A picture of 0.4 megapixels takes about
25 minutes on two quiet cores, of which 70,000 Gaussians take 10: 2.5 hours in all. What is there is not measured
again, so that methods, numbers and pictures can be added to a run.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from benchmarks.arguments import integers, some_of
from benchmarks.machine import RUNS, Record
from benchmarks.pictures import add_options, named_in
from benchmarks.report.fits import representation
from benchmarks.representation.fits import METHODS, NETWORKS, measured
from benchmarks.speed.sizes import alone
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import ms_ssim, psnr
from sgmethod.metrics.perceptual import Networks


def seconds_of_rd(record: Record, gaussians: int, image: str) -> float:
    """That rd took for the same. Raises SystemExit if it was not measured."""
    for row in record.rows:
        if (row["method"], row["asked"], row["image"]) == ("rd", gaussians, image):
            return float(row["seconds"])
    raise SystemExit(f"{image}: networks take as long as rd with {gaussians} Gaussians; measure rd first")


def measure(
    method: str, path: Path, gaussians: int, steps: int, seconds: float | None, seen: Networks | None
) -> dict[str, Any]:
    """One fit in a process of its own; this one compares what it shows."""
    row = alone(measured, method, path, gaussians, steps, seconds)
    shown, pixels = row.pop("shown"), read_image_8_bit(path.read_bytes())
    quality = {"psnr": psnr(shown, pixels), "ms_ssim": ms_ssim(shown, pixels)}
    return {**quality, "lpips": seen.lpips(shown, pixels) if seen else None, **row}


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.representation",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_options(parser, most=6)
    parser.add_argument("--gaussians", type=integers, default="5000,10000,30000,70000", help="numbers, with commas")
    parser.add_argument("--steps", type=int, default=3000, help="of every fit of Gaussians")
    parser.add_argument(
        "--methods", type=some_of(METHODS, "method"), default=",".join(METHODS), help="those that are measured"
    )
    parser.add_argument("--weights", type=Path)
    parser.add_argument("--out", type=Path, default=RUNS / "representation.json")
    options = parser.parse_args()
    # Of the fits' processes: torch's threads that spin for each other make a step take ten times as long where anything
    # else runs.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    methods = [method for method in METHODS if method in options.methods]
    seen = Networks(options.weights) if options.weights else None
    settings = {"steps": options.steps, "lpips": seen is not None}
    record = Record(options.out, "benchmarks.representation", settings)
    for path in named_in(options):
        for asked in options.gaussians:
            for method in methods:
                key = {"method": method, "asked": asked, "image": path.name}
                if not record.has(**key):
                    seconds = seconds_of_rd(record, asked, path.name) if method in NETWORKS else None
                    record.add({**key, **measure(method, path, asked, options.steps, seconds, seen)})
    print(f"\n{representation({**record.content, 'rows': record.rows}).text()}")


if __name__ == "__main__":
    main()
