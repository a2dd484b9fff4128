"""What shows a picture by a fixed number of Gaussians, before any is coded, and networks of as many numbers.

Each fit runs in a process of its own, which has a peak of memory of its own.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks import networks
from benchmarks.networks import Network, Training
from benchmarks.pictures import Pixels
from benchmarks.speed.sizes import peak_mib
from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Moments
from sgmethod.bitstream.payload import MIN_QUANTUM
from sgmethod.decoder import draw
from sgmethod.fitting.deadline import Clock, Deadline
from sgmethod.fitting.level import Level, Pyramid
from sgmethod.fitting.objective import Objective
from sgmethod.fitting.recorder import Recorder
from sgmethod.io.image import read_image_8_bit
from sgmethod.native import native
from sgmethod.paper import fit as paper
from sgmethod.rd.densify import densify, prune
from sgmethod.rd.fit import fit
from sgmethod.rd.place import place
from sgmethod.rd.rate_control import RateControl
from sgmethod.rd.request import Plan, Request, State, stages
from sgmethod.rd.steer import steer
from sgmethod.scene import Gaussians, Scene
from sgmethod.settings.paper import BASELINE, PAPER, PaperSettings
from sgmethod.settings.rd import RD, RdSettings, Times
from sgmethod.start import placement

NUMBERS_OF_GAUSSIAN = 8  # 2 of the centre, 3 of the factor, 3 of the colour
# No quantisation follows here, so the price on large colours, which only that needs, is left out.
FLOAT = replace(PAPER, lambda_e=0.0)
VARIANTS: dict[str, PaperSettings] = {
    "paper": FLOAT,
    "unregularised": replace(FLOAT, lambda_g=0.0),
    "random-start": replace(FLOAT, start=replace(FLOAT.start, structure_guided=False)),
    "baseline": replace(BASELINE, lambda_e=0.0),
}
NETWORKS: dict[str, Callable[[Pixels, int], Network]] = {"siren": networks.siren, "wire": networks.wire}
METHODS = ("rd", *VARIANTS, *NETWORKS)

# A large network takes fewer pixels a step: in the seconds of a fit of Gaussians, steps are what it lacks. In 8 s and
# 12 s on a busy machine, 1,024 to 4,096 pixels are 0.6 to 1.3 dB better than 16,384.
NUMBERS_OF_WHOLE_BATCH, SMALLEST_BATCH = 10_000, 1 << 10
# And smaller steps: after 12 s on kodim01 with 560,000 numbers, a tenth of the rate of SIREN is 3.9 dB better, and a
# fifth of that of WIRE 1.1 dB.
NUMBERS_OF_WHOLE_RATE, RATE_POWER = 2048, 0.4
DRAWS, DRAWING_S = 9, 10.0  # of one picture, after a first one; no more once so many seconds are over

# Of a fit of profile rd that is longer than the profile's, as parts of its steps:
STEPS_OF_GROWTH = 40  # between two growths
GROWTH_UNTIL, TRIM_UNTIL = 0.6, 0.8  # bits are free from the last trim on
TRIMS = 8


@dataclass(frozen=True)
class Fitted:
    """draw: the picture, at its full size; numbers: that it is made of; gaussians: that have them, if any."""

    draw: Callable[[], Pixels]
    numbers: int
    gaussians: int | None = None


def measured(method: str, path: Path, gaussians: int, steps: int, seconds: float | None) -> dict[str, Any]:
    """The picture as a method shows it, and what that took. seconds: of a network."""
    torch.set_num_threads(native.thread_count() if method in NETWORKS else 1)  # or they and the kernels' would wait
    pixels = read_image_8_bit(path.read_bytes())
    fitted_by(method, pixels[:32, :32], 10, 10, 0.0)  # what the first fit of a process loads is no part of any method
    began = time.perf_counter()
    fitted = fitted_by(method, pixels, gaussians, steps, seconds)
    taken, mib = time.perf_counter() - began, peak_mib()
    shown, drawing_s = drawn(fitted.draw)
    return {
        "shown": shown,
        "gaussians": fitted.gaussians,
        "seconds": taken,
        "frames_per_s": 1 / drawing_s,
        "mib": mib,
        "thousand_numbers": fitted.numbers / 1000,
    }


def fitted_by(method: str, pixels: Pixels, gaussians: int, steps: int, seconds: float | None) -> Fitted:
    """One of METHODS."""
    if method == "rd":
        return by_rd(pixels, gaussians, lengthened(steps))
    if method in VARIANTS:
        return by_paper(pixels, gaussians, replace(VARIANTS[method], fit_steps=steps), 0)
    return by_network(NETWORKS[method], pixels, NUMBERS_OF_GAUSSIAN * gaussians, seconds or 0.0)


def drawn(draw: Callable[[], Pixels]) -> tuple[Pixels, float]:
    """The picture, and the median of the seconds that several draws take; the first counts where there is no other."""
    times: list[float] = []
    until = time.perf_counter() + DRAWING_S
    while not times or (len(times) <= DRAWS and time.perf_counter() < until):
        began = time.perf_counter()
        shown = draw()
        times.append(time.perf_counter() - began)
    return shown, statistics.median(times[1:] or times)


def by_rd(pixels: Pixels, gaussians: int, settings: RdSettings) -> Fitted:
    """While Gaussians come and go, bits have their price: it decides well which Gaussians stay. At the end bits are
    free."""
    clock, area = Clock(), pixels.shape[0] * pixels.shape[1]
    quantum = 0.8 * settings.rate.gaussians_per_pixel * area / gaussians  # leaves a few more to choose from
    rate = RateControl(settings, area, quantum, max_gaussians=gaussians)
    objective = Objective.of(pixels, "psnr", settings.objective)
    request = Request(objective, rate, Deadline(clock), Kernels(), settings, Recorder(clock))
    plan = Plan(request, settings, Pyramid.of(request.level(), settings.pyramid))
    start, steps = place(request, plan.pyramid), settings.effort.steps
    state = State(start, Moments.none(len(start)), quantum, objective.moving_target(plan.whole.target))
    for stage in stages(request.deadline.pace(steps), settings.effort.times):
        if stage.is_due:
            state = densify(plan, steer(plan, prune(plan, state, stage), stage), stage)
        if stage.at >= TRIM_UNTIL:
            state = replace(state, quantum=MIN_QUANTUM)
        state = fit(plan, state, stage)
    return _fitted(plan.whole, state.gaussians, request.background)


def by_paper(pixels: Pixels, gaussians: int, settings: PaperSettings, seed: int) -> Fitted:
    """Profile paper's fit, or the same with a part left out."""
    return _fitted(*fit_of_paper(pixels, gaussians, settings, seed), (0, 0, 0))


def fit_of_paper(pixels: Pixels, gaussians: int, settings: PaperSettings, seed: int) -> tuple[Level, Gaussians]:
    """The picture as the fit sees it, and its Gaussians."""
    image, clock, level = pixels.astype(np.float32) / np.float32(255), Clock(), paper.level_of(pixels, Kernels())
    start = placement.place(image, gaussians, settings.start, np.random.default_rng(seed))
    return level, paper.fit(level, start, settings, Recorder(clock), Deadline(clock))[0]


def by_network(make: Callable[[Pixels, int], Network], pixels: Pixels, numbers: int, seconds: float) -> Fitted:
    """A network of at most so many numbers, moved for so many seconds."""
    began = time.perf_counter()
    network = make(pixels, numbers)
    slower = min(NUMBERS_OF_WHOLE_RATE / numbers, 1) ** RATE_POWER
    network = replace(network, rate=network.rate * slower)
    batch = round(networks.BATCH * min(NUMBERS_OF_WHOLE_BATCH / numbers, 1))
    training = Training(network, pixels, max(batch, SMALLEST_BATCH))
    training.step()
    while time.perf_counter() - began < seconds:
        training.step()
    return Fitted(lambda: networks.drawn(network, pixels.shape), network.size())


def lengthened(steps: int) -> RdSettings:
    """The profile with more steps. Gaussians come and go for longer too: in 4,000 steps, 60 growths make 0.2 dB more
    than ten growths and a longer rest."""
    growths = max(round(GROWTH_UNTIL * steps / STEPS_OF_GROWTH), len(RD.effort.times.growth_at))
    trim_from = GROWTH_UNTIL + 0.02
    times = Times(
        steering_from=0.03,
        growth_at=tuple(np.linspace(0.01, GROWTH_UNTIL, growths).tolist()),
        trim_at=tuple(np.linspace(trim_from, TRIM_UNTIL, TRIMS).tolist()),
        excess_from=0.7 * GROWTH_UNTIL,
        excess_until=TRIM_UNTIL,
        halved_until=RD.effort.times.halved_until * RD.effort.steps / steps,
    )
    optimiser = replace(RD.fit.optimiser, final_rate=0.1)
    return replace(RD, effort=replace(RD.effort, steps=steps, times=times), fit=replace(RD.fit, optimiser=optimiser))


def _fitted(level: Level, gaussians: Gaussians, background: tuple[int, int, int]) -> Fitted:
    frame = level.frame
    scene = Scene(gaussians, frame.width, frame.height, background, frame.cutoff, frame.pyramid)
    return Fitted(lambda: draw(scene), NUMBERS_OF_GAUSSIAN * len(gaussians), len(gaussians))
