"""Time of rendering and of its gradients, on Gaussians that were fitted to a picture.

Fitted Gaussians matter: random ones are of other sizes and overlap differently. Laying the Gaussians over the
tiles is part of every time, because a fit does it at every step and a decoder once per picture; it is measured
alone too. All configurations take turns in every round, so that a busy moment of the machine falls on all alike.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from benchmarks.machine import ISA_NAMES
from sgmethod.backend.kernels import Kernels
from sgmethod.fitting.deadline import Clock, Deadline
from sgmethod.fitting.recorder import Recorder
from sgmethod.native import native
from sgmethod.paper.fit import fit, level_of
from sgmethod.scene import Gaussians
from sgmethod.settings.paper import PAPER
from sgmethod.start.placement import place

SIZE = (768, 512)


def load(path: Path) -> NDArray[np.uint8]:
    """Pixels of a picture brought to SIZE."""
    with Image.open(path) as picture:
        return np.asarray(ImageOps.fit(picture.convert("RGB"), SIZE, Image.Resampling.LANCZOS))


def fitted(pixels: NDArray[np.uint8], n: int, steps: int) -> tuple[Gaussians, float]:
    """n Gaussians after a number of steps of profile paper's fit, or fewer if it comes to rest, and the seconds of a
    step."""
    settings = replace(PAPER, fit_steps=steps)
    start = place(pixels.astype(np.float32) / np.float32(255), n, settings.start, np.random.default_rng(0))
    clock = Clock()
    gaussians, done = fit(level_of(pixels, Kernels()), start, settings, Recorder(clock), Deadline(clock))
    return gaussians, clock.seconds() / done


class Jobs:
    """What is timed, on one set of Gaussians."""

    def __init__(self, gaussians: Gaussians) -> None:
        self.shapes, self.colors = (gaussians.means, gaussians.factors), gaussians.colors
        self.image = np.empty((3, SIZE[1], SIZE[0]), np.float32)
        self.upstream = np.random.default_rng(0).standard_normal(self.image.shape, np.float32)
        self.gradients = Gaussians.empty(len(gaussians)).arrays
        self.by_name: dict[str, Callable[[int], None]] = {
            "binning": self.binning,
            "forward": self.forward,
            "forward + backward": self.both,
        }

    def binning(self, isa: int) -> None:
        """Geometry over tiles."""
        native.Rasterization(*self.shapes, *SIZE, isa=isa)

    def forward(self, isa: int) -> None:
        """Geometry and picture."""
        native.Rasterization(*self.shapes, *SIZE, isa=isa).render(self.colors, self.image)

    def both(self, isa: int) -> None:
        """Geometry, picture, all gradients."""
        raster = native.Rasterization(*self.shapes, *SIZE, isa=isa)
        raster.render(self.colors, self.image)
        raster.backward(self.colors, self.upstream, *self.gradients)


def measure(jobs: Jobs, rounds: int, isas: range) -> Iterator[dict[str, Any]]:
    """Milliseconds of all jobs for each instruction set, with one thread and with all, taking turns."""
    every = native.thread_count()
    samples = defaultdict(list)
    for _ in range(rounds):
        for threads in sorted({1, every}):
            native.set_thread_count(threads)
            jobs.forward(0)  # starts the threads
            for isa in isas:
                for name, job in jobs.by_name.items():
                    began = time.perf_counter()
                    job(isa)
                    samples[name, isa, threads].append(1e3 * (time.perf_counter() - began))
    native.set_thread_count(every)
    for (name, isa, threads), times in sorted(samples.items()):
        median, p10, p90 = (round(float(q), 3) for q in np.percentile(times, (50, 10, 90)))
        found = {"job": name, "isa": ISA_NAMES[isa], "threads": threads}
        yield {**found, "median_ms": median, "p10_ms": p10, "p90_ms": p90}
