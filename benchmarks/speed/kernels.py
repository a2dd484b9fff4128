"""Time drawing and its gradients, on Gaussians that were fitted to a picture.

    python -m benchmarks.speed kernels [--images FOLDER] [--steps 300] [--rounds 40] [--out FILE]

Fitted Gaussians matter: random ones are of other sizes and overlap differently. Every time includes laying the
Gaussians over the tiles, because a fit does that at every step and a decoder once per picture; it is measured
alone too. All configurations take turns in every round, so that a busy moment of the machine falls on all alike.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageOps

from benchmarks.machine import ISA_NAMES, RUNS, Record
from benchmarks.pictures import Pixels, chosen_from
from sgmethod.fitting.deadline import Clock, Deadline
from sgmethod.fitting.recorder import Recorder
from sgmethod.native import native
from sgmethod.paper.fit import fit, level_of
from sgmethod.paper.placement import place_by_structure
from sgmethod.paper.settings import PAPER
from sgmethod.scene import Gaussians
from tests.support.data import PHOTOGRAPHS

SIZE = (768, 512)
GAUSSIANS = 5000


def load(path: Path) -> Pixels:
    """Pixels of a picture brought to SIZE."""
    with Image.open(path) as picture:
        return np.asarray(ImageOps.fit(picture.convert("RGB"), SIZE, Image.Resampling.LANCZOS))


def fitted(pixels: Pixels, n: int, steps: int) -> Gaussians:
    """n Gaussians after a number of steps of profile paper's fit, or fewer if it comes to rest."""
    settings, clock = replace(PAPER, fit_steps=steps), Clock()
    start = place_by_structure(pixels.astype(np.float32) / np.float32(255), n, settings.start, np.random.default_rng(0))
    return fit(level_of(pixels), start, settings, Recorder(clock), Deadline.from_limit(clock))[0]


def jobs_on(gaussians: Gaussians) -> dict[str, Callable[[int], object]]:
    """The functions to time, by name. Each takes an instruction set."""
    image = np.empty((3, SIZE[1], SIZE[0]), np.float32)
    upstream = np.random.default_rng(0).standard_normal(image.shape, np.float32)
    gradients = Gaussians.empty(len(gaussians)).arrays

    def binning(isa: int) -> native.Rasterization:
        return native.Rasterization(gaussians.means, gaussians.factors, *SIZE, isa=isa)

    def forward(isa: int) -> None:
        binning(isa).render(gaussians.colors, image)

    def both(isa: int) -> None:
        raster = binning(isa)
        raster.render(gaussians.colors, image)
        raster.backward(gaussians.colors, upstream, *gradients)

    return {"binning": binning, "forward": forward, "forward + backward": both}


def measure(gaussians: Gaussians, rounds: int) -> Iterator[dict[str, Any]]:
    """Milliseconds of all jobs for each instruction set, with one thread and with all, taking turns."""
    every, jobs = native.thread_count(), jobs_on(gaussians)
    samples = defaultdict(list)
    for _ in range(rounds):
        for threads in sorted({1, every}):
            native.set_thread_count(threads)
            jobs["forward"](0)  # starts the threads
            for isa in range(native.best_isa() + 1):
                for name, job in jobs.items():
                    began = time.perf_counter()
                    job(isa)
                    samples[name, isa, threads].append(1e3 * (time.perf_counter() - began))
    native.set_thread_count(every)
    for (name, isa, threads), times in sorted(samples.items()):
        median, p10, p90 = (round(float(q), 3) for q in np.percentile(times, (50, 10, 90)))
        found = {"job": name, "isa": ISA_NAMES[isa], "threads": threads}
        yield {**found, "median_ms": median, "p10_ms": p10, "p90_ms": p90}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, default=PHOTOGRAPHS, help="a folder, whose first picture is fitted")
    parser.add_argument("--steps", type=int, default=300, help="of the fit")
    parser.add_argument("--rounds", type=int, default=40, help="times that each kernel is timed")
    parser.add_argument("--out", type=Path, default=RUNS / "kernels.json")
    options = parser.parse_args()
    record = Record(options.out, "benchmarks.speed kernels", {"steps": options.steps, "rounds": options.rounds})
    if not record.rows:
        gaussians = fitted(load(chosen_from(options.images, 1)[0]), GAUSSIANS, options.steps)
        for row in measure(gaussians, options.rounds):
            record.add(row)
