"""Variants of profile paper with a fixed number of Gaussians, before any is coded.

Each fit runs in a process of its own, which has a peak of memory of its own.
"""

from __future__ import annotations

import statistics
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.ablation.report import REPRESENTATIONS
from benchmarks.pictures import Pixels
from benchmarks.speed.sizes import peak_mib
from sgmethod.backend.kernels import Kernels
from sgmethod.decoder import draw
from sgmethod.fitting.deadline import Clock, Deadline
from sgmethod.fitting.level import Level
from sgmethod.fitting.recorder import Recorder
from sgmethod.io.image import read_image_8_bit
from sgmethod.paper import fit as paper
from sgmethod.scene import Gaussians, Scene
from sgmethod.settings.paper import BASELINE, PAPER, PaperSettings
from sgmethod.start import placement

# No quantisation follows here, so the price on large colours, which only that needs, is left out.
FLOAT = replace(PAPER, lambda_e=0.0)
_SETTINGS = (
    FLOAT,
    replace(FLOAT, lambda_g=0.0),
    replace(FLOAT, start=replace(FLOAT.start, structure_guided=False)),
    replace(BASELINE, lambda_e=0.0),
)
VARIANTS: dict[str, PaperSettings] = dict(zip(REPRESENTATIONS, _SETTINGS, strict=True))
DRAWS, DRAWING_S = 9, 10.0  # of one picture, after a first one; fewer if they take longer than DRAWING_S


def measured(method: str, path: Path, gaussians: int, steps: int) -> dict[str, Any]:
    """The picture that a method shows, and its costs."""
    torch.set_num_threads(1)  # or its threads and the kernels' would wait for each other
    pixels = read_image_8_bit(path.read_bytes())
    settings = VARIANTS[method]
    by_paper(pixels[:32, :32], 10, replace(settings, fit_steps=10), 0)  # or the first would pay for what is loaded
    began = time.perf_counter()
    scene = by_paper(pixels, gaussians, replace(settings, fit_steps=steps), 0)
    taken, mib = time.perf_counter() - began, peak_mib()
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


def by_paper(pixels: Pixels, gaussians: int, settings: PaperSettings, seed: int) -> Scene:
    """Profile paper's fit, or the same with a part left out."""
    level, found = fit_of_paper(pixels, gaussians, settings, seed)
    frame = level.frame
    return Scene(found, frame.width, frame.height, (0, 0, 0), frame.cutoff, frame.pyramid)


def fit_of_paper(pixels: Pixels, gaussians: int, settings: PaperSettings, seed: int) -> tuple[Level, Gaussians]:
    """The picture as the fit sees it, and its Gaussians."""
    image, clock, level = pixels.astype(np.float32) / np.float32(255), Clock(), paper.level_of(pixels, Kernels())
    start = placement.place(image, gaussians, settings.start, np.random.default_rng(seed))
    return level, paper.fit(level, start, settings, Recorder(clock), Deadline(clock))[0]
