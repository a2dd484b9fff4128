"""Fit exactly N Gaussians in floating point, without making a file.

The method is that of rd/encode.py: place, prune, steer, densify, fit. Rounding, the search over integers and the rounds
after it are left out, because only a file needs them. For most of the steps, Gaussians are added and dropped. The last
steps only move the N that stay.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sgmethod.backend.protocol import Backend
from sgmethod.fitting.deadline import Clock, Deadline
from sgmethod.fitting.level import Pyramid
from sgmethod.fitting.objective import Objective
from sgmethod.numerics import quiet
from sgmethod.rd.densify import place, prune_to_limit
from sgmethod.rd.encode import run
from sgmethod.rd.levels import Levels
from sgmethod.rd.problem import Problem
from sgmethod.rd.rate_control import GAUSSIANS_PER_PIXEL, GAUSSIANS_QUANTUM, GaussianCount, surplus
from sgmethod.rd.schedule import first_run
from sgmethod.rd.sparse import whole_of
from sgmethod.rd.state import Stage, State
from sgmethod.scene import Gaussians, Pixels
from sgmethod.settings.rd import RD, RdSettings

# Times are fractions of the run, 0 to 1.
SHARE_OF_STEPS = 0.6  # default steps, as a part of an effort's: nothing has to be rounded
STEPS_OF_GROWTH = 40  # between two; in 4,000 steps, 60 growths make 0.2 dB more than ten and a longer rest
MIN_GROWTHS, GROWTH_UNTIL = 5, 0.6
TRIMS, TRIM_UNTIL = 8, 0.8
FEW_UNTIL = 0.3  # Times.few_until
# Quantum that prices bits until the last trim, in multiples of that at which growth would find as many Gaussians; at
# most that of an encode of as many, because few Gaussians on a smooth picture cannot pay for more.
PRICE = 0.8
FINAL_RATE = (0.1, 0.5)  # of many and of few steps
FEW_STEPS = 75.0  # divided by the number of steps, this is the final rate

OnStep = Callable[[float], None]  # called with the share of the steps that are taken, 0 to 1


@dataclass(frozen=True)
class Exact:
    """N Gaussians over a background in 8 bits, and the mean squared error that they leave, 1 being white."""

    gaussians: Gaussians
    background: tuple[int, int, int]
    error: float


@dataclass(frozen=True)
class ExactFit:
    """A fit of pictures of any size.

    gaussians: how many; steps: None for as many as the picture needs; quantum: sets the price of bits, 0 for none.
    """

    gaussians: int
    steps: int | None = None
    quantum: float = 0.0

    @quiet
    def fit(self, pixels: Pixels, backend: Backend, clock: Clock, on_step: OnStep) -> Exact:
        """Fit a picture [H, W, 3]; the largest Gaussians come first."""
        rate = GaussianCount(pixels[..., 0].size, self.quantum, max_gaussians=self.gaussians)
        steps = self.steps or round(SHARE_OF_STEPS * first_run(RD.effort, rate))
        settings = schedule_of(steps)
        problem = Problem(Objective.from_pixels(pixels, "psnr"))
        whole = whole_of(problem, backend)
        pyramid = Pyramid.from_whole(whole, self.gaussians)
        levels = Levels(problem, pyramid, self.gaussians, settings.effort, settings.optimiser)
        state = levels.begin(place(levels, rate), self.quantum)
        guide = _Guide(levels, rate, lambda taken: on_step(taken / steps))
        state = run(levels, rate, guide, state, Deadline.from_limit(clock).pace(steps), settings.effort.times)
        found = guide.complete(state).gaussians
        found = found.rows(np.argsort(-found.factors[:, 0] * found.factors[:, 2], kind="stable"))
        return Exact(found, problem.background, backend.error(found, whole.frame, whole.target))


def schedule_of(steps: int) -> RdSettings:
    """Adapt the settings of profile rd to a fit of this many steps."""
    growths = max(round(GROWTH_UNTIL * steps / STEPS_OF_GROWTH), MIN_GROWTHS)
    times = replace(
        RD.effort.times,
        growth_at=tuple(np.linspace(0.01, GROWTH_UNTIL, growths).tolist()),
        trim_at=tuple(np.linspace(GROWTH_UNTIL + 0.02, TRIM_UNTIL, TRIMS).tolist()),
        excess_from=0.7 * GROWTH_UNTIL,
        excess_until=TRIM_UNTIL,
        few_until=FEW_UNTIL,
    )
    low, high = FINAL_RATE
    optimiser = replace(RD.optimiser, final_rate=min(max(FEW_STEPS / steps, low), high))
    effort = replace(RD.effort, steps=steps, times=times, rounds=(0,))
    return replace(RD, effort=effort, optimiser=optimiser)


@dataclass(frozen=True)
class _Guide:
    """The guide of a fit without a file. on_steps: called with the number of steps taken."""

    levels: Levels
    rate: GaussianCount
    on_steps: Callable[[int], None]

    def steer(self, state: State, stage: Stage) -> State:
        """Set the quantum that prices bits while Gaussians come and go; from the last trim on, exactly N stay."""
        times, n, free = stage.times, self.rate.max_gaussians, self.rate.quantum
        if stage.at == times.trim_at[-1]:
            return self.complete(replace(state, quantum=free))
        chosen = min(PRICE * GAUSSIANS_PER_PIXEL * self.levels.problem.pixels.size / 3 / n, GAUSSIANS_QUANTUM)
        return replace(state, quantum=max(chosen / float(times.finer_early ** surplus(times, stage.at)), free))

    def report(self, state: State) -> None:
        """Pass on the steps taken."""
        self.on_steps(state.steps)

    def complete(self, state: State) -> State:
        """Return the state with exactly N Gaussians. More are placed at random where most error is left."""
        n, level, lot = self.rate.max_gaussians, self.levels.finest, np.random.default_rng(0)
        state = prune_to_limit(self.levels, self.rate, state, self.levels.effort.times)
        more = n - len(state.gaussians)
        if more == 0:
            return state
        missing = level.missing(state.gaussians)(0, level.frame.height)
        error = np.square(missing, dtype=np.float64).sum(0).ravel() + 1e-12
        places = np.stack(np.divmod(lot.choice(error.size, more, p=error / error.sum()), level.frame.width)[::-1], 1)
        means = ((places + lot.random((more, 2))) * level.frame.spacing).astype(np.float32)
        radius = math.sqrt(level.pixels / (math.pi * n)) * level.frame.spacing
        radius = max(radius, self.levels.optimiser.min_scale_px)
        factors = np.tile(np.array([radius, 0, radius], np.float32), (more, 1))
        new = Gaussians(means, factors, np.zeros((more, 3), np.float32))
        return replace(state, gaussians=state.gaussians.with_more(new), moments=state.moments.with_more(more))
