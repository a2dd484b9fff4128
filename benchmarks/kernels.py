"""Time of rendering and of its gradients, on Gaussians that were fitted to a picture.

    python -m benchmarks.kernels [--images FOLDER]

Fitted Gaussians matter: random ones are of other sizes and overlap differently. Laying the Gaussians over the
tiles is part of every time, because a fit does it at every step and a decoder once per picture; it is measured
alone too. All configurations take turns in every round, so that a busy moment of the machine falls on all alike.
"""

from __future__ import annotations

import argparse
import os
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageOps

from benchmarks.machine import ISA_NAMES, RESULTS, in_words, origin, write_json
from benchmarks.pictures import pictures_in
from sgmethod.fitting.parameters import Parameters
from sgmethod.fitting.picture import Picture, target_of
from sgmethod.fitting.recorder import Clock, Recorder
from sgmethod.native import native
from sgmethod.paper.fit import fit
from sgmethod.profiles import PAPER
from sgmethod.start.placement import place
from tests.harness.data import PHOTOGRAPHS

SIZE = (768, 512)
FIT_TARGET_S = 10.0  # 1,000 steps of profile paper's fit, regularisation included, two cores
TARGETS_MS = {"forward": 2.0, "forward + backward": 8.0}  # best instruction set, two cores
BUSY = 0.5  # load of the last minute above which the cores are not ours alone


@dataclass(frozen=True)
class Spread:
    """Milliseconds of one job in one configuration."""

    job: str
    isa: str
    threads: int
    median_ms: float
    p10_ms: float
    p90_ms: float


def load(folder: Path | None) -> tuple[str, NDArray[np.uint8]]:
    """Name and pixels of the folder's first picture, or of a test picture, brought to SIZE."""
    path = PHOTOGRAPHS / "kodim23-crop.png"
    if folder is not None:
        pictures = pictures_in(folder)
        if not pictures:
            raise SystemExit(f"there is no picture in {folder}")
        path = pictures[0]
    with Image.open(path) as picture:
        fitted = ImageOps.fit(picture.convert("RGB"), SIZE, Image.Resampling.LANCZOS)
    return path.name, np.asarray(fitted)


def fitted(pixels: NDArray[np.uint8], n: int, steps: int) -> tuple[Parameters, float]:
    """n Gaussians after so many steps of the fit, and the seconds these took."""
    torch.set_num_threads(1)  # as encode() does: two pools of threads on the same cores cost several times the time
    settings = replace(PAPER, fit_steps=steps)
    start = place(pixels.astype(np.float32) / np.float32(255), n, settings, np.random.default_rng(0))
    picture = Picture(target_of(pixels), settings.lambda_g, native.CUTOFF_V1)
    clock = Clock()
    gaussians, done = fit(picture, start, settings, Recorder(clock, None), None)
    if done < steps:
        raise SystemExit(f"the fit converged after {done} steps: nothing to time")
    return Parameters.of(gaussians), clock.seconds()


class Jobs:
    """What is timed, on one set of Gaussians."""

    def __init__(self, p: Parameters) -> None:
        self.shapes = p.means.numpy(), p.factors.numpy()
        self.colors = p.colors.numpy()
        self.image = np.empty((3, SIZE[1], SIZE[0]), np.float32)
        self.upstream = np.random.default_rng(0).standard_normal(self.image.shape, np.float32)
        self.gradients = [np.empty_like(array) for array in (*self.shapes, self.colors)]
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


def measure(jobs: Jobs, rounds: int) -> list[Spread]:
    """All jobs for each instruction set, with one thread and with all, taking turns."""
    every = native.thread_count()
    samples = defaultdict(list)
    for _ in range(rounds):
        for threads in sorted({1, every}):
            native.set_thread_count(threads)
            jobs.forward(0)  # starts the threads
            for isa in range(native.best_isa() + 1):
                for name, job in jobs.by_name.items():
                    began = time.perf_counter()
                    job(isa)
                    samples[name, isa, threads].append(1e3 * (time.perf_counter() - began))
    native.set_thread_count(every)
    return [
        Spread(name, ISA_NAMES[isa], threads, *(round(float(q), 3) for q in np.percentile(times, (50, 10, 90))))
        for (name, isa, threads), times in sorted(samples.items())
    ]


def table(spreads: list[Spread]) -> str:
    """Markdown."""
    lines = ["| job | instruction set | threads | median ms | p10 | p90 |", "|---|---|---|---|---|---|"]
    lines += [
        f"| {s.job} | {s.isa} | {s.threads} | {s.median_ms:.2f} | {s.p10_ms:.2f} | {s.p90_ms:.2f} |" for s in spreads
    ]
    return "\n".join(lines)


def verdicts(spreads: list[Spread]) -> list[str]:
    """Each target with what was reached: best instruction set, all threads."""
    lines = []
    for job, limit in TARGETS_MS.items():
        mine = [s for s in spreads if s.job == job and s.isa == ISA_NAMES[native.best_isa()]]
        reached = max(mine, key=lambda s: s.threads)
        word = "met" if reached.median_ms <= limit else "missed"
        lines.append(f"{job}: {reached.median_ms:.2f} ms with {reached.threads} threads, at most {limit:g} ms: {word}")
    return lines


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.kernels", description="Time of the compiled kernels.")
    parser.add_argument("--images", type=Path, help="folder whose first picture is fitted (default: a test picture)")
    parser.add_argument("--gaussians", type=int, default=5000)
    parser.add_argument("--steps", type=int, default=1000, help="of the fit beforehand, which is timed too")
    parser.add_argument("--rounds", type=int, default=60)
    parser.add_argument("--out", type=Path, default=RESULTS / "kernels.json")
    options = parser.parse_args()
    name, image = load(options.images)
    load_before = os.getloadavg()[0]
    p, fit_s = fitted(image, options.gaussians, options.steps)
    spreads = measure(Jobs(p), options.rounds)
    where = origin()
    setup = {
        "picture": name,
        "size": SIZE,
        "gaussians": options.gaussians,
        "fit_steps": options.steps,
        "fit_s": round(fit_s, 3),
    }
    setup |= {"rounds": options.rounds, "load_before": load_before}
    write_json(options.out, {**where, **setup, "times": [vars(s) for s in spreads]})
    print(f"{options.gaussians} Gaussians fitted to {name} at {SIZE[0]} x {SIZE[1]}, {options.rounds} rounds\n")
    fit_line = f"{options.steps} steps of the fit: {fit_s:.2f} s (1,000 in at most {FIT_TARGET_S:g} s)"
    print(table(spreads), *verdicts(spreads), fit_line, in_words(where), sep="\n\n")
    if load_before > BUSY:
        print(f"\nOther processes were running (load {load_before:.1f}): times with all threads are too long.")


if __name__ == "__main__":
    main()
