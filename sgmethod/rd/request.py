"""What the steps of the pipeline are given: the request, the plan made from it, and the state of the fit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.protocol import Backend, Coding, Frame, Moments, Visibility
from sgmethod.bitstream.v2 import StreamV2, coded_background
from sgmethod.fitting.deadline import Deadline, Pace
from sgmethod.fitting.level import Histogram, Level, Pyramid, target_of
from sgmethod.fitting.moving_target import MovingTarget
from sgmethod.fitting.objective import Objective
from sgmethod.fitting.recorder import Recorder
from sgmethod.rd.rate_control import RateControl
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import RdSettings, Times

Pixels = NDArray[np.uint8]


@dataclass(frozen=True)
class Request:
    """One picture to encode, without alpha: everything that its pipeline needs to know.

    with_shear: shear is coded even where no Gaussian has any, as an alpha part has no flag that says so; spread: of
    the levels of a channel, at most.
    """

    objective: Objective
    rate: RateControl
    deadline: Deadline
    backend: Backend
    settings: RdSettings
    recorder: Recorder
    seed: int = 0
    with_shear: bool = False
    background: tuple[int, int, int] = field(init=False)
    grey: bool = field(init=False)
    spread: int = field(init=False)

    def __post_init__(self) -> None:
        pixels, found = self.pixels, Histogram(self.pixels)
        background = coded_background(found.background, self.rate.is_short)
        grey = len(set(background)) == 1 and bool((pixels == pixels[:, :, :1]).all())
        object.__setattr__(self, "background", background)
        object.__setattr__(self, "grey", grey)
        object.__setattr__(self, "spread", found.spread)

    @property
    def pixels(self) -> Pixels:
        """[H, W, 3]."""
        return self.objective.pixels

    @property
    def size(self) -> tuple[int, int]:
        """(width, height)."""
        return self.pixels.shape[1], self.pixels.shape[0]

    @property
    def samples(self) -> int:
        """Of the picture, whose mean squared error is minimised."""
        return self.pixels.size

    @property
    def is_one_colour(self) -> bool:
        """Whether the picture is its background, and needs no Gaussian."""
        return self.spread == 0

    @property
    def is_nearly_flat(self) -> bool:
        """Whether rounding to 8 bits may be all that the background misses."""
        return self.spread <= 2

    def pyramid(self) -> Pyramid:
        """The picture in the sizes that its file can show."""
        target = target_of(self.pixels, self.background)
        whole = Level(self.backend, Frame(*self.size), target, self.objective.visibility)
        return Pyramid.of(whole, self.settings.pyramid, self.rate.expected_gaussians())

    def coding(self, quantum: float) -> Coding:
        """How a quantum codes this picture."""
        return Coding(*self.size, quantum, self.grey, is_short=self.rate.is_short)

    def stream(self, gaussians: Gaussians, quantum: float) -> StreamV2:
        """The coded picture."""
        own = self.background, self.grey, self.with_shear, self.rate.is_short
        return StreamV2.of(gaussians, self.size, quantum, *own)


@dataclass(frozen=True)
class Plan:
    """A request with the settings and the sizes of its picture that fit into its time."""

    request: Request
    settings: RdSettings
    pyramid: Pyramid

    @property
    def finest(self) -> Level:
        """The picture that the file can show."""
        return self.pyramid.finest

    @cached_property
    def shown(self) -> Visibility | None:
        """What alpha shows of the finest level."""
        shown = self.request.objective.shown
        for _ in range(self.finest.frame.spacing.bit_length() - 1):
            shown = shown and shown.halved()
        return shown

    @property
    def lengths(self) -> list[int]:
        """Steps of the first run and of each round, those for a PSNR that is missed included."""
        first = self.request.rate.steps(self.settings)
        a_round = max(round(self.settings.schedule.round_steps * first), 1)
        further = self.request.rate.further_rounds
        return [first, *[a_round] * (self.settings.effort.rounds[-1] + further)]

    def all_steps(self, done: int) -> int:
        """Steps of the encode, as known after those done: rounds for a missed PSNR count once they have begun."""
        expected = sum(self.lengths[: self.settings.effort.rounds[-1] + 1])
        return expected if done <= expected else sum(self.lengths)

    def begin(self, gaussians: Gaussians) -> State:
        """The state of the fit before its first step."""
        request, finest = self.request, self.finest
        target = request.objective.moving_target(finest.target, finest.frame.spacing, request.background[0])
        return State(gaussians, Moments.none(len(gaussians)), request.rate.quantum, target)

    def times(self, run: int) -> Times:
        """What is due when in a run: the first, 0, or a round."""
        times = self.settings.effort.times if run == 0 else self.settings.schedule.round_times
        return times if run >= self.settings.effort.rounds[-1] else replace(times, many_from=1.0)


@dataclass(frozen=True)
class Stage:
    """A part of a run: whatever is due at `at` is done once, then steps are taken until `until`."""

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
        """Whether the last growth is over, now that progress has been made."""
        return self.pace.progress > self.times.growth_at[-1]


def stages(pace: Pace, times: Times) -> Iterator[Stage]:
    """The stages of a run in their order, but for those that are over before they begin."""
    due = {*times.growth_at, *times.trim_at}
    for at, until in pairwise(sorted({0.0, *due, 1.0})):
        if pace.progress < until:
            yield Stage(pace, times, at, until, at in due)


@dataclass(frozen=True)
class State:
    """Where a fit stands.

    moments: the optimiser's; target: of the finest level, as it moves; steps: taken so far; size: of the file in bytes,
    about; saturated_price: the price of a bit at which growth last found next to nothing.
    """

    gaussians: Gaussians
    moments: Moments
    quantum: float
    target: MovingTarget
    steps: int = 0
    size: int = 0
    saturated_price: float = np.inf

    def rows(self, index: NDArray[np.intp]) -> State:
        """The same with these Gaussians alone, in their order."""
        return replace(self, gaussians=self.gaussians.rows(index), moments=self.moments.rows(index))
