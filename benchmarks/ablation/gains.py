"""Measure what the paper's start gains in floating point, over all pictures of a folder, with our optimiser.

    python -m benchmarks.ablation gains --images FOLDER [--tables numbers,crops] [--numbers 30000] [--steps 3000]

numbers    10,000 to 90,000 Gaussians on the middle 384x256 of each picture: random, fixed 6:2:1 and dynamic
crops      30,000 and 70,000 on the middle 64x64

Numbers of Gaussians are for 768x512 pixels; smaller pictures have as many for each pixel, and n_0 and N_t with them.
"""

from __future__ import annotations

import argparse
import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.arguments import integers, some_of
from benchmarks.machine import RUNS, Record
from benchmarks.ms_ssim import ms_ssim
from benchmarks.pictures import Pixels, add_options, middle_of, named_in
from benchmarks.tables import mean, number, standard_error, table
from sgmethod.backend.protocol import MAX_CUTOFF
from sgmethod.decoder import draw
from sgmethod.fitting.deadline import Clock, Deadline
from sgmethod.fitting.recorder import Recorder
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import psnr
from sgmethod.paper import fit as paper
from sgmethod.paper.placement import place_by_structure
from sgmethod.paper.settings import PAPER, StartSettings
from sgmethod.scene import Gaussians, Scene

PIXELS = 768 * 512
Measured = dict[str, Any]  # a row of a JSON
PLAIN = replace(PAPER, lambda_g=0.0, fit_steps=3000)
STARTS = {
    "random": replace(PLAIN.start, structure_guided=False),
    "fixed": replace(PLAIN.start, threshold_factor=math.inf),
    "dynamic": PLAIN.start,
}


@dataclass(frozen=True)
class Table:
    """Fits of each number of Gaussians on the middle of each picture, in pixels."""

    numbers: tuple[int, ...]
    middle: tuple[int, int]


TABLES = {
    "crops": Table((70_000, 30_000), (64, 64)),
    "numbers": Table((70_000, 90_000, 50_000, 30_000, 10_000), (384, 256)),
}


def starts_of(n: int) -> tuple[str, ...]:
    """The starts that differ with so many Gaussians: the dynamic ratio begins as the fixed one."""
    return ("random", "fixed", "dynamic") if n > 30_000 else ("random", "dynamic")


@cache  # of several rows and seeds
def pixels_of(path: Path, middle: tuple[int, int] | None) -> Pixels:
    """A picture or its middle; turned where it is upright, so that all have one size."""
    pixels = read_image_8_bit(path.read_bytes())
    if pixels.shape[0] > pixels.shape[1]:
        pixels = np.rot90(pixels)
    if middle is not None:
        return middle_of(pixels, middle[1], middle[0])
    return np.ascontiguousarray(pixels)


def placed(start: StartSettings, asked: int, pixels: Pixels, seed: int) -> Gaussians:
    """A start on a picture, with as many Gaussians for each pixel as are asked for 768x512."""
    part = pixels.shape[0] * pixels.shape[1] / PIXELS
    k = start.threshold_factor * part ** (1 - start.threshold_exponent)  # so that N_t is that part, too
    start = replace(start, ratio_start=round(part * start.ratio_start), threshold_factor=k)
    image = pixels.astype(np.float32) / np.float32(255)
    return place_by_structure(image, round(part * asked), start, np.random.default_rng(seed))


def measure(pixels: Pixels, start: Gaussians, steps: int) -> Measured:
    """Fit by profile paper's optimiser; return the figures of the fit."""
    clock = Clock()
    settings, deadline = replace(PLAIN, fit_steps=steps), Deadline.from_limit(clock, None)
    gaussians = paper.fit(paper.level_of(pixels), start, settings, Recorder(clock), deadline)[0]
    height, width = pixels.shape[:2]
    shown = draw(Scene(gaussians, width, height, (0, 0, 0), MAX_CUTOFF, False))
    seen = ms_ssim(shown, pixels) if min(width, height) > 160 else None
    return {"gaussians": len(gaussians), "psnr": psnr(shown, pixels), "ms_ssim": seen}


def summary(rows: Sequence[Measured]) -> str:
    """A table of means over pictures, and of the gains of each setting over those measured before it."""
    lines = []
    every: dict[tuple[str, int], dict[str, dict[str, list[Measured]]]] = {}  # by setting and picture: one of each seed
    for row in rows:
        by = every.setdefault((row["table"], row["asked"]), {})
        by.setdefault(row["setting"], {}).setdefault(row["image"], []).append(row)
    for (name, asked), by in every.items():
        for k, (setting, found) in enumerate(by.items()):
            psnr = number(mean([figure(rows, "psnr") for rows in found.values()]), ".2f")
            cells = [name, f"{asked:,}", setting, len(found), psnr]
            lines += [[*cells, *gain(found, by[other], other)] for other in [*by][:k]] or [[*cells, "", "", "", "", ""]]
    titles = "table | Gaussians | start | pictures | PSNR | against | dB | standard error | MS-SSIM | better on"
    return table(titles, lines)


def figure(rows: Sequence[Measured], name: str) -> float:
    """The mean of a figure over the seeds of one picture; NaN where it was not measured."""
    return statistics.fmean(math.nan if row[name] is None else row[name] for row in rows)


def gain(found: dict[str, list[Measured]], others: dict[str, list[Measured]], other: str) -> list[str]:
    """The cells of a gain over another setting, over the pictures of both. The error is over pictures."""
    pairs = [(rows, others[image]) for image, rows in found.items() if image in others]
    db = [figure(rows, "psnr") - figure(its, "psnr") for rows, its in pairs]
    seen = mean([by for rows, its in pairs if not math.isnan(by := figure(rows, "ms_ssim") - figure(its, "ms_ssim"))])
    better = f"{sum(one > 0 for one in db)} of {len(db)}"
    return [other, number(mean(db), "+.2f"), number(standard_error(db), ".2f"), number(seen, "+.5f"), better]


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.ablation gains",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_options(parser, most=24)
    parser.add_argument("--tables", type=some_of(tuple(TABLES), "table"), default=",".join(TABLES))
    parser.add_argument("--numbers", type=integers, help="of Gaussians; all")
    parser.add_argument("--steps", type=int, default=PLAIN.fit_steps, help="of each fit")
    parser.add_argument("--out", type=Path, default=RUNS / "gains.json")
    options = parser.parse_args()
    torch.set_num_threads(1)  # or its threads and the kernels' would wait for each other
    record = Record(options.out, "benchmarks.ablation gains", {"steps": options.steps})
    for name in options.tables:
        numbers = [asked for asked in TABLES[name].numbers if asked in (options.numbers or TABLES[name].numbers)]
        each = [(asked, start) for asked in numbers for start in starts_of(asked)]
        for (asked, start), path in product(each, named_in(options)):
            key = {"table": name, "asked": asked, "setting": start, "image": path.stem, "seed": 0}
            if not record.has(**key):
                pixels = pixels_of(path, TABLES[name].middle)
                record.add({**key, **measure(pixels, placed(STARTS[start], asked, pixels, 0), options.steps)})
    print(f"\n{summary(record.rows)}")
