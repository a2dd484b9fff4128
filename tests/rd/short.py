"""What encodes of a fraction of a second are made of, and clocks that are the same on every machine."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Backend
from sgmethod.budget import Budget
from sgmethod.fitting.deadline import Clock, Deadline
from sgmethod.fitting.objective import Objective
from sgmethod.fitting.recorder import Recorder
from sgmethod.rd.budgets import rate_of
from sgmethod.rd.place import place
from sgmethod.rd.plan import Plan, Stage, State
from sgmethod.rd.request import Request
from sgmethod.settings.paper import PAPER, PaperSettings
from sgmethod.settings.rd import RD, RdSettings
from sgmethod.settings.shared import Tune
from sgmethod.trace import Stop


def short(steps: int, **of_effort: Any) -> RdSettings:
    """The settings of the default effort with a first run of `steps` steps."""
    return replace(RD, effort=replace(RD.effort, steps=steps, **of_effort))


def shortened(steps: int, phase_steps: tuple[int, int] | None = None) -> dict[str, RdSettings | PaperSettings]:
    """Settings of all profiles with a short first run, and short phases of paper."""
    fit, tune = phase_steps or (steps, steps)
    return {"rd": short(steps), "paper": replace(PAPER, fit_steps=fit, tune_steps=tune)}


class SlowClock(Clock):
    """Each look at it takes a hundredth of a second, and nothing else does."""

    def __init__(self, stop: Stop | None = None, look_s: float = 0.01) -> None:
        super().__init__(stop)
        self.now, self.look_s = 0.0, look_s

    def seconds(self) -> float:
        self.now += self.look_s
        return self.now


def requested(
    pixels: NDArray[np.uint8],
    budget: Budget,
    tune: Tune = "psnr",
    *,
    settings: RdSettings = RD,
    deadline: Deadline | None = None,
    backend: Backend | None = None,
    recorder: Recorder | None = None,
) -> Request:
    """A request of profile rd, as rd/picture.py makes it."""
    clock = Clock()
    objective = Objective.from_pixels(np.ascontiguousarray(pixels), tune, settings.objective, texture=True)
    rate = rate_of(budget, pixels.shape[1::-1], settings)
    deadline, recorder = deadline or Deadline.from_limit(clock), recorder or Recorder(clock)
    return Request(objective, rate, deadline, backend or Kernels(), recorder)


def begun(request: Request) -> tuple[Plan, State]:
    """The plan of a request, and the state before its first step."""
    pyramid = request.pyramid()
    gaussians = place(request, pyramid)
    plan = Plan.from_request(request, pyramid, gaussians)
    return plan, plan.begin(gaussians)


def stage_of(plan: Plan, steps: int, at: float = 0.0) -> Stage:
    """A stage of `steps` steps that has reached this part of the first run."""
    pace = Deadline.from_limit(Clock()).pace(steps)
    pace.progress = at
    return Stage(pace, plan.times(0), at, 1.0)
