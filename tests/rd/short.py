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
from sgmethod.rd.densify import densify, place
from sgmethod.rd.encode import KERNELS, encode
from sgmethod.rd.fit import fit
from sgmethod.rd.levels import Levels
from sgmethod.rd.picture import rate_of
from sgmethod.rd.problem import Problem, Session
from sgmethod.rd.rate_control import Coded, RateControl
from sgmethod.rd.schedule import Schedule, planned
from sgmethod.rd.search import Search
from sgmethod.rd.sparse import pyramid_of
from sgmethod.rd.state import Stage, State
from sgmethod.rd.steer import Steering
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
    def levels(self) -> Levels:
        """Before anything is placed."""
        expected = self.rate.expected_gaussians()
        pyramid = pyramid_of(self.problem, expected, self.backend)
        return Levels(self.problem, pyramid, expected, self.settings.effort, self.settings.optimiser)

    def begun(self) -> Begun:
        """All that an encode has before its first step."""
        deadline, gaussians = self.session.deadline, place(self.levels, self.rate)
        levels, rate, schedule = planned(self.levels, self.rate, deadline, gaussians)
        return Begun(levels, rate, schedule, levels.begin(gaussians, rate.quantum), self.session.recorder)


@dataclass(frozen=True)
class Begun:
    """An encode, its state and its steps."""

    levels: Levels
    rate: RateControl
    schedule: Schedule
    state: State
    recorder: Recorder

    def stage(self, steps: int, at: float = 0.0) -> Stage:
        """A stage of `steps` steps that has reached this part of the first run."""
        pace = Deadline.from_limit(Clock()).pace(steps)
        pace.progress = at
        return Stage(pace, self.schedule.times(0), at, 1.0)

    @property
    def guide(self) -> Steering:
        return Steering(self.levels, self.rate, self.schedule, self.recorder)

    def steered(self, stage: Stage) -> Begun:
        return replace(self, state=self.guide.steer(self.state, stage))

    def grown(self, stage: Stage) -> Begun:
        return replace(self, state=densify(self.levels, self.rate, self.state, stage))

    def fitted(self, stage: Stage) -> Begun:
        return replace(self, state=fit(self.levels, self.state, stage, self.guide.report))

    def found(self, rounds: int) -> Coded:
        """The file after this many rounds."""
        return Search(self.levels, self.rate, self.schedule.deadline, self.recorder, self.state, rounds).file()


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
