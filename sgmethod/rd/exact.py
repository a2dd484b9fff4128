"""Exactly N Gaussians in floating point, from which no file is made.

The method is that of encode.py: place, prune, densify, fit. What only a file needs is left out: steering, rounding, the
search over integers, and the rounds that follow it. Gaussians come and go for most of the steps, and the last steps are
for those that stay.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sgmethod.backend.protocol import Backend, Frame
from sgmethod.fitting.deadline import Clock, Deadline, cosine
from sgmethod.fitting.level import target_of
from sgmethod.fitting.objective import Objective
from sgmethod.fitting.recorder import Recorder
from sgmethod.numerics import quiet
from sgmethod.rd.densify import densify, prune, settle
from sgmethod.rd.place import place
from sgmethod.rd.plan import Plan, Stage, State, stages, within_pixels
from sgmethod.rd.rate_control import GaussianCount, surplus
from sgmethod.rd.request import Request
from sgmethod.scene import Gaussians, Pixels
from sgmethod.settings.exact import EXACT, exact_schedule
from sgmethod.settings.rd import RD, Times

STEPS_TOGETHER = 16  # between two reports
OnStep = Callable[[float], None]  # called with the progress, 0 to 1


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
    seed: int = 0

    @quiet
    def fit(self, pixels: Pixels, backend: Backend, clock: Clock, on_step: OnStep) -> Exact:
        """Fit a picture [H, W, 3]; the largest Gaussians come first."""
        plan = self._plan(pixels, backend, clock)
        times, n = plan.settings.effort.times, self.gaussians
        state = plan.begin(place(plan.request, plan.pyramid))
        for stage in stages(plan.request.deadline.pace(plan.settings.effort.steps), times):
            if stage.is_due:
                state = prune(plan, state, stage)
                state = replace(state, quantum=self._quantum(plan, times, stage.at))
                state = densify(plan, state, stage)
            if stage.at == times.trim_at[-1]:
                state = _complete(plan, replace(state, quantum=self.quantum), n)
            state = _fitted(plan, state, stage, on_step)
        found = _complete(plan, state, n).gaussians
        found = found.rows(np.argsort(-found.factors[:, 0] * found.factors[:, 2], kind="stable"))
        background = plan.request.background
        error = backend.error(found, Frame(*plan.request.size), target_of(pixels, background))
        return Exact(found, background, error)

    def _quantum(self, plan: Plan, times: Times, at: float) -> float:
        """Return the quantum that prices bits while Gaussians come and go: it decides well which of them stay."""
        rate = plan.settings.rate
        dense = EXACT.price * rate.gaussians_per_pixel * plan.request.samples / 3 / self.gaussians
        chosen = min(dense, rate.gaussians_quantum)
        return max(chosen / float(times.finer_early ** surplus(times, at)), self.quantum)

    def _plan(self, pixels: Pixels, backend: Backend, clock: Clock) -> Plan:
        height, width = pixels.shape[:2]
        rate = replace(GaussianCount.from_count(self.gaussians, height * width, RD), quantum=self.quantum)
        steps = self.steps or round(EXACT.share_of_steps * rate.steps(RD))
        settings = exact_schedule(steps)
        objective = Objective.from_pixels(pixels, "psnr", settings.objective)
        request = Request(objective, rate, Deadline.from_limit(clock), backend, settings, Recorder(clock), self.seed)
        pyramid = request.pyramid()
        return Plan(request, within_pixels(settings, pyramid), pyramid)


def _fitted(plan: Plan, state: State, stage: Stage, on_step: OnStep) -> State:
    """Take the steps of a stage."""
    s, size = plan.settings.fit, len(state.gaussians)
    gaussians, moments, price = state.gaussians.copy(), state.moments.copy(), s.rate_weight * state.bit_price
    for progress in stage.pace.together(stage.until, lambda: STEPS_TOGETHER):
        level = plan.level_for(state, stage, size)
        rates = [cosine(s.optimiser.final_rate, at) for at in progress]
        plan.request.backend.steps(gaussians, moments, plan.descent(level, state.quantum, price), rates)
        on_step(stage.pace.progress)
    return replace(state, gaussians=gaussians, moments=moments)


def _complete(plan: Plan, state: State, n: int) -> State:
    """Return the state with exactly n Gaussians. Those still missing are placed at random where most error is left."""
    state = settle(plan, state, plan.settings.effort.times)
    more, level, lot = n - len(state.gaussians), plan.finest, np.random.default_rng(plan.request.seed)
    if more == 0:
        return state
    error = np.square(level.missing(state.gaussians)(0, level.frame.height), dtype=np.float64).sum(0).ravel() + 1e-12
    places = np.stack(np.divmod(lot.choice(error.size, more, p=error / error.sum()), level.frame.width)[::-1], 1)
    means = ((places + lot.random((more, 2))) * level.frame.spacing).astype(np.float32)
    radius = max(
        math.sqrt(level.pixels / (math.pi * n)) * level.frame.spacing, plan.settings.fit.optimiser.min_scale_px
    )
    factors = np.tile(np.array([radius, 0, radius], np.float32), (more, 1))
    new = Gaussians(means, factors, np.zeros((more, 3), np.float32))
    return replace(state, gaussians=state.gaussians.with_more(new), moments=state.moments.with_more(more))
