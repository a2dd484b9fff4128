"""Fit exactly N Gaussians in floating point, without making a file.

The method is that of rd/encode.py: place, prune, densify, fit. Steering, rounding, the search over integers and the
rounds after it are left out, because only a file needs them. For most of the steps, Gaussians are added and dropped.
The last steps only move the N that stay.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sgmethod.backend.protocol import Backend, Frame
from sgmethod.fitting.deadline import Clock, Deadline
from sgmethod.fitting.level import target_of
from sgmethod.fitting.objective import Objective
from sgmethod.fitting.recorder import Recorder
from sgmethod.numerics import quiet
from sgmethod.rd.densify import densify, prune, prune_to_limit
from sgmethod.rd.fit import fit
from sgmethod.rd.place import place
from sgmethod.rd.plan import Plan, State, stages, within_pixels
from sgmethod.rd.rate_control import GaussianCount, surplus
from sgmethod.rd.request import Request
from sgmethod.scene import Gaussians, Pixels
from sgmethod.settings.rd import RD, Times
from sgmethod.torch.schedule import EXACT, exact_schedule

OnStep = Callable[[float], None]  # called with the share of the steps that are taken, 0 to 1


@dataclass(frozen=True)
class Exact:
    """N Gaussians over a background in 8 bits, and the mean squared error that they leave, 1 being white."""

    gaussians: Gaussians
    background: tuple[int, int, int]
    error: float


@dataclass(frozen=True, kw_only=True)
class _Shares(Recorder):
    """Recorder that passes on the share of the steps taken, and measures nothing."""

    total: int
    on_step: OnStep

    def report(self, _phase: str, step: int, *_figures: object) -> None:
        self.on_step(step / self.total)


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
        request = self._request(pixels, backend, clock, on_step)
        pyramid, n = request.pyramid(), self.gaussians
        plan = Plan(request.with_settings(within_pixels(request.settings, pyramid)), pyramid)
        state, times = plan.begin(place(request, pyramid)), plan.settings.effort.times
        for stage in stages(request.deadline.pace(plan.settings.effort.steps), times):
            if stage.is_due:
                state = prune(plan, state, stage)
                state = replace(state, quantum=self._quantum(plan, times, stage.at))
                state = densify(plan, state, stage)
            if stage.at == times.trim_at[-1]:
                state = _complete(plan, replace(state, quantum=self.quantum), n)
            state = fit(plan, state, stage)
        found = _complete(plan, state, n).gaussians
        found = found.rows(np.argsort(-found.factors[:, 0] * found.factors[:, 2], kind="stable"))
        error = backend.error(found, Frame(*request.size), target_of(pixels, request.background))
        return Exact(found, request.background, error)

    def _quantum(self, plan: Plan, times: Times, at: float) -> float:
        """Return the quantum that prices bits while Gaussians come and go: it decides well which of them stay."""
        rate = plan.settings.rate
        dense = EXACT.price * rate.gaussians_per_pixel * plan.request.samples / 3 / self.gaussians
        chosen = min(dense, rate.gaussians_quantum)
        return max(chosen / float(times.finer_early ** surplus(times, at)), self.quantum)

    def _request(self, pixels: Pixels, backend: Backend, clock: Clock, on_step: OnStep) -> Request:
        """Return the request of an encode to as many Gaussians, with the schedule and the price of bits of this fit."""
        height, width = pixels.shape[:2]
        rate = replace(GaussianCount.from_count(self.gaussians, height * width, RD), quantum=self.quantum)
        steps = self.steps or round(EXACT.share_of_steps * rate.steps())
        rate = replace(rate, settings=exact_schedule(steps))
        recorder = _Shares(clock, total=steps, on_step=on_step)
        objective = Objective.from_pixels(pixels, "psnr", rate.settings.objective, texture=False)
        return Request(objective, rate, Deadline.from_limit(clock), backend, recorder, self.seed)


def _complete(plan: Plan, state: State, n: int) -> State:
    """Return the state with exactly n Gaussians. Those still missing are placed at random where most error is left."""
    state = prune_to_limit(plan, state, plan.settings.effort.times)
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
