"""State: the progress of a fit. Stage: a part of a run, between two events of its schedule."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.protocol import Moments, Target
from sgmethod.fitting.deadline import Pace
from sgmethod.fitting.moving_target import FitTarget
from sgmethod.rd.rate_control import error_per_bit
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import Times


@dataclass(frozen=True)
class Stage:
    """A part of a run: what is due at `at` is done once, then steps are taken until `until`."""

    pace: Pace
    times: Times
    at: float
    until: float
    is_due: bool = True

    @property
    def grows(self) -> bool:
        """Whether Gaussians are added."""
        return self.at in self.times.growth_at

    @property
    def has_grown(self) -> bool:
        """Whether the last growth of the run is over by now."""
        return self.pace.progress > self.times.growth_at[-1]


def stages(pace: Pace, times: Times) -> Iterator[Stage]:
    """Yield the stages of a run, except those that are over before they begin."""
    due = {*times.growth_at, *times.trim_at}
    for at, until in pairwise(sorted({0.0, *due, times.few_until, times.many_from, 1.0})):
        if pace.progress < until:
            yield Stage(pace, times, at, until, at in due)


@dataclass(frozen=True)
class Aim:
    """What refining aims at, and the mean squared error of the fit that it begins with, as it would decode."""

    target: Target
    error: Callable[[], float]


@dataclass(frozen=True)
class State:
    """The state of a fit.

    moments: those of the optimiser; target: the moving target of the finest level; steps: taken so far; size: estimated
    size of the file in bytes; saturated_price: price of a bit at which growth last found next to nothing; is_enough:
    see RateControl.is_enough(); step_length: factor on the longest step; retaken: steps that were taken again;
    aim: of the search, once no run follows it.
    """

    gaussians: Gaussians
    moments: Moments
    quantum: float
    target: FitTarget
    steps: int = 0
    size: int = 0
    saturated_price: float = np.inf
    is_enough: bool = False
    step_length: float = 1.0
    retaken: int = 0
    aim: Aim | None = None

    @property
    def bit_price(self) -> float:
        """Squared error that one bit is worth."""
        return error_per_bit(self.quantum)

    def rows(self, index: NDArray[np.intp]) -> State:
        """Return the state with only these Gaussians, in this order."""
        return replace(self, gaussians=self.gaussians.rows(index), moments=self.moments.rows(index))


class Guide(Protocol):
    """What the loop asks, so that it needs to know no file and no clock."""

    def steer(self, state: State, stage: Stage) -> State:
        """Set the quantum, and so the price of a bit."""

    def report(self, state: State) -> None:
        """See the state after some steps."""
