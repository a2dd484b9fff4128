"""What encodes of a fraction of a second are made of, and clocks that are the same on every machine."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.protocol import Backend
from sgmethod.bitstream.v2 import StreamV2
from sgmethod.budget import Budget
from sgmethod.fitting.deadline import Clock, Deadline
from sgmethod.fitting.objective import Objective
from sgmethod.fitting.recorder import Recorder
from sgmethod.rd.densify import place
from sgmethod.rd.encode import KERNELS, encode
from sgmethod.rd.picture import rate_of
from sgmethod.rd.plan import Plan, Stage, State
from sgmethod.rd.problem import Problem, Session
from sgmethod.rd.rate_control import RateControl
from sgmethod.rd.sparse import pyramid_of
from sgmethod.settings.rd import RD, RdSettings
from sgmethod.settings.shared import Tune


def short(steps: int, **of_effort: Any) -> RdSettings:
    """The settings of the default effort with a first run of `steps` steps."""
    return replace(RD, effort=replace(RD.effort, steps=steps, **of_effort))


class SlowClock(Clock):
    """Each look at it takes a hundredth of a second, and nothing else does."""

    def __init__(self, look_s: float = 0.01) -> None:
        super().__init__()
        self.now, self.look_s = 0.0, look_s

    def seconds(self) -> float:
        self.now += self.look_s
        return self.now


@dataclass(frozen=True)
class Asked:
    """What rd/encode.py is given, as rd/picture.py makes it."""

    problem: Problem
    settings: RdSettings
    rate: RateControl
    session: Session
    backend: Backend

    def encode(self) -> tuple[StreamV2, int]:
        return encode(self.problem, self.settings, self.rate, self.session, self.backend)

    @property
    def plan(self) -> Plan:
        """Before anything is placed."""
        pyramid = pyramid_of(self.problem, self.rate.expected_gaussians(), self.backend)
        return Plan(self.problem, self.settings, self.rate, self.session, pyramid)

    def begun(self) -> tuple[Plan, State]:
        """The plan, and the state before its first step."""
        plan = self.plan
        gaussians = place(plan)
        plan = plan.in_time(gaussians)
        return plan, plan.begin(gaussians)


def asked(
    pixels: NDArray[np.uint8],
    budget: Budget,
    tune: Tune = "psnr",
    *,
    settings: RdSettings = RD,
    deadline: Deadline | None = None,
    backend: Backend = KERNELS,
) -> Asked:
    clock = Clock()
    objective = Objective.from_pixels(np.ascontiguousarray(pixels), tune)
    rate = rate_of(budget, pixels.shape[1::-1], settings.effort)
    session = Session(deadline or Deadline.from_limit(clock), Recorder(clock))
    return Asked(Problem(objective, rate.is_short(objective, has_alpha=False)), settings, rate, session, backend)


def stage_of(plan: Plan, steps: int, at: float = 0.0) -> Stage:
    """A stage of `steps` steps that has reached this part of the first run."""
    pace = Deadline.from_limit(Clock()).pace(steps)
    pace.progress = at
    return Stage(pace, plan.times(0), at, 1.0)
