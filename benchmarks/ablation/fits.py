"""Fits of a fixed number of Gaussians, before any is coded: profiles rd and paper.

Each fit runs in a process of its own, which has a peak of memory of its own.
"""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.machine import peak_bytes
from benchmarks.pictures import Pixels
from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Frame
from sgmethod.decoder import draw
from sgmethod.fitting.deadline import Clock, Deadline
from sgmethod.fitting.level import Level
from sgmethod.fitting.recorder import Recorder
from sgmethod.io.image import read_image_8_bit
from sgmethod.paper import fit as paper
from sgmethod.rd.exact import ExactFit
from sgmethod.scene import Gaussians, Scene
from sgmethod.settings.paper import PAPER, PaperSettings
from sgmethod.start import placement

DRAWS, DRAWING_S = 9, 10.0  # of one picture, after a first one; fewer if they take longer than DRAWING_S


def measured(method: str, path: Path, gaussians: int, steps: int) -> dict[str, Any]:
    """The picture that a method shows, and its costs."""
    torch.set_num_threads(1)  # or its threads and the kernels' would wait for each other
    pixels = read_image_8_bit(path.read_bytes())
    fitted(method, pixels[:32, :32], 10, 10)  # or the first would pay for what is loaded
    began = time.perf_counter()
    scene = fitted(method, pixels, gaussians, steps)
    taken, mib = time.perf_counter() - began, peak_bytes() / 2**20
    shown, drawing_s = drawn(scene)
    costs = {"gaussians": len(scene.gaussians), "seconds": taken, "frames_per_s": 1 / drawing_s, "mib": mib}
    return {"shown": shown, **costs}


def drawn(scene: Scene) -> tuple[Pixels, float]:
    """The picture, and the median of the seconds that several draws take; the first counts where there is no other."""
    times: list[float] = []
    until = time.perf_counter() + DRAWING_S
    while not times or (len(times) <= DRAWS and time.perf_counter() < until):
        began = time.perf_counter()
        shown = draw(scene)
        times.append(time.perf_counter() - began)
    return shown, statistics.median(times[1:] or times)


def fitted(method: str, pixels: Pixels, gaussians: int, steps: int) -> Scene:
    """The fit of one of REPRESENTATIONS."""
    if method == "rd":
        return by_rd(pixels, gaussians, steps)
    return fit_of_paper(pixels, gaussians, replace(PAPER, fit_steps=steps)).scene


def by_rd(pixels: Pixels, gaussians: int, steps: int) -> Scene:
    """Profile rd's fit of exactly so many."""
    found = ExactFit(gaussians, steps).fit(pixels, Kernels(), Clock(), lambda _: None)
    height, width = pixels.shape[:2]
    frame = Frame(width, height)
    return Scene(found.gaussians, width, height, found.background, frame.cutoff, frame.pyramid)


@dataclass(frozen=True)
class PaperFit:
    """A fit of profile paper: the picture as it sees it, its Gaussians, and the steps they took."""

    level: Level
    gaussians: Gaussians
    steps: int

    @property
    def scene(self) -> Scene:
        """The Gaussians to draw."""
        frame = self.level.frame
        return Scene(self.gaussians, frame.width, frame.height, (0, 0, 0), frame.cutoff, frame.pyramid)


def fit_of_paper(
    pixels: Pixels,
    gaussians: int,
    settings: PaperSettings,
    seed: int = 0,
    clock: Clock | None = None,
    limit_s: float | None = None,
) -> PaperFit:
    """Profile paper's fit, or the same with a part left out."""
    image, clock = pixels.astype(np.float32) / np.float32(255), clock or Clock()
    level = paper.level_of(pixels, Kernels())
    start = placement.place(image, gaussians, settings.start, np.random.default_rng(seed))
    return PaperFit(level, *paper.fit(level, start, settings, Recorder(clock), Deadline(clock, limit_s)))
