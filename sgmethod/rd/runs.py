"""Runs of the schedule of one fit, within the time that there is."""

from __future__ import annotations

import math

from sgmethod.fitting.request import Request
from sgmethod.fitting.schedule import Schedule
from sgmethod.rd.fit import RdFit
from sgmethod.rd.rate_control import RateControl
from sgmethod.trace import Preview

LEAST_PART = 1 / 3  # of the time that it took to make a fit, for its first run, however late that is


def place(request: Request, control: RateControl, preview: Preview) -> RdFit:
    """Few Gaussians, ready to be fitted."""
    left_s = request.left_s(control.settings.fit_share)
    return RdFit(request.pixels, control, request.seed, request.recorder.clock, preview, request.alpha, left_s)


def steps_of_round(control: RateControl) -> int:
    """Steps of each round."""
    return max(round(control.settings.round_steps * control.steps()), 1)


def most_steps(control: RateControl) -> int:
    """Steps of the first run and all rounds."""
    return control.steps() + control.settings.rounds[-1] * steps_of_round(control)


class Runs:
    """Runs of the schedule of one fit: the first, and rounds.

    steps, rounds: done so far; in_all, before: the encode's steps, and those before this fit, for the trace.
    """

    def __init__(self, fit: RdFit, request: Request, in_all: int, before: int = 0) -> None:
        self.fit, self.request = fit, request
        self.in_all, self.before = in_all, before
        self.steps, self.rounds, self.took_s = 0, 0, 0.0
        self.least_until_s = 0.0

    def first(self) -> None:
        """Fit and grow; a time limit or a stop shortens the schedule, but not to nothing: Gaussians as they are placed
        make a poor file, and a little more time a much better one."""
        left_s = self.request.left_s(self.fit.settings.fit_share)
        if math.isfinite(left_s):
            self.fit.hurry(left_s)
            self.least_until_s = self.request.recorder.clock.seconds() + LEAST_PART * self.fit.made_s
        length = self.fit.control.steps()
        self._run(length)
        self.took_s *= steps_of_round(self.fit.control) / length

    def has_time(self) -> bool:
        """Whether a further round, as long as the last, ends in time."""
        return self.took_s < self.request.left_s(self.fit.settings.fit_share)

    def until_round(self, number: int) -> None:
        """Rounds until there were so many, as far as there is time."""
        while self.rounds < number and self.has_time():
            self.fit.begin_round()
            self._run(steps_of_round(self.fit.control))
            self.rounds += 1

    def _run(self, length: int) -> None:
        clock, final_rate = self.request.recorder.clock, self.fit.settings.final_rate
        began = clock.seconds()
        part = Schedule("joint", length, final_rate, self._until, 1.0, self.before + self.steps, self.in_all)
        self.steps += part.run(self.request.recorder, self.fit.step, self.fit.decoded_mse)
        self.took_s = clock.seconds() - began
        self.fit.settle()

    def _until(self) -> float | None:
        until_s = self.request.until_s(self.fit.settings.fit_share)
        return None if until_s is None else max(until_s, self.least_until_s)
