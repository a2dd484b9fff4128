"""Profile rd in the order in which it runs.

1. place      few Gaussians, where the picture has structure                        (fit.py)
2. fit        all Gaussians together, under the price of their bits                 (fit.py)
3. grow       more Gaussians, between the steps of the fit, where they pay          (growth.py)
4. quantise   with the quantum that meets the budget best                           (finish.py, quantiser.py)
5. refine     the integers of each Gaussian, on the picture that the others leave   (native/refine/refine.cpp)
6. write      the bytes of a version 4 file                                         (bitstream/)

Rate control (rate_control.py) steers the quantum through 2 and 3, and sets what 4 has to meet. More effort repeats 2 to
5 in rounds: more Gaussians than can stay are added and fitted, those that gain least go, and the best file is kept.
"""

from __future__ import annotations

import torch

from sgmethod.bitstream import container
from sgmethod.bitstream.v4 import StreamV4
from sgmethod.fitting.request import Request
from sgmethod.fitting.schedule import Schedule
from sgmethod.native import native
from sgmethod.profiles import RdSettings
from sgmethod.rd.finish import Finish
from sgmethod.rd.fit import RdFit
from sgmethod.rd.rate_control import RateControl


def encode(request: Request, settings: RdSettings) -> tuple[bytes, int]:
    """The file, and the optimiser steps it took. Raises BudgetError for a budget no file can meet."""
    control = RateControl.of(request, settings)
    with torch.no_grad():
        fit = place(request, control)
        runs = Runs(fit, request)
        runs.first()
        found = []
        for rounds in settings.rounds[:-1]:
            runs.until_round(rounds)
            if not runs.has_time():
                break
            found.append(Finish(fit, request).stream())
        runs.until_round(settings.rounds[-1])
        finish = Finish(fit, request)
        steps = runs.steps
        del fit, runs  # what only steps need
        native.release_memory()
        return write(finish.best([*found, finish.stream()])), steps


def place(request: Request, control: RateControl) -> RdFit:
    """Few Gaussians, ready to be fitted."""
    recorder = request.recorder
    return RdFit(request.pixels, control, request.seed, recorder.clock, recorder.preview)


class Runs:
    """Runs of the schedule: the first, and rounds. steps, rounds: done so far."""

    def __init__(self, fit: RdFit, request: Request) -> None:
        self.fit, self.request = fit, request
        self.length = fit.control.steps()
        self.of_round = max(round(fit.settings.round_steps * self.length), 1)
        self.in_all = self.length + fit.settings.rounds[-1] * self.of_round
        self.steps, self.rounds, self.took_s = 0, 0, 0.0

    def first(self) -> None:
        """Fit and grow; a time limit or a stop shortens the schedule."""
        until_s = self._until()
        if until_s is not None:
            self.fit.hurry(until_s - self.request.recorder.clock.seconds())
        self._run(self.length, 0)
        self.took_s *= self.of_round / self.length

    def has_time(self) -> bool:
        """Whether a further round, as long as the last, ends in time."""
        until_s = self._until()
        return until_s is None or self.request.recorder.clock.seconds() + self.took_s < until_s

    def until_round(self, number: int) -> None:
        """Rounds until there were so many, as far as there is time."""
        while self.rounds < number and self.has_time():
            self.fit.begin_round()
            self._run(self.of_round, self.length + self.rounds * self.of_round)
            self.rounds += 1

    def _run(self, length: int, before: int) -> None:
        clock, final_rate = self.request.recorder.clock, self.fit.settings.final_rate
        began = clock.seconds()
        part = Schedule("joint", length, final_rate, self._until, 1.0, before, self.in_all)
        self.steps += part.run(self.request.recorder, self.fit.step, self.fit.decoded_mse)
        self.took_s = clock.seconds() - began
        self.fit.settle()

    def _until(self) -> float | None:
        return self.request.until_s(self.fit.settings.fit_share)


def write(stream: StreamV4) -> bytes:
    """The file's bytes."""
    return container.serialise(stream)
