"""The schedule of a fit: how the rate falls, and when it is over."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from sgmethod.fitting.recorder import Recorder

PERFECT_MSE = 1e-7  # 70 dB: a tenth of what rounding to 8 bits leaves
PROGRESS_DB = 0.01  # what counts as progress

Until = Callable[[], float | None]
Step = Callable[[float, float], tuple[float, tuple[int, int]]]


def never() -> None:
    """No limit."""


@dataclass(frozen=True)
class Schedule:
    """One phase of an encode, or a run that is a part of it: its name in the trace, its steps, the part of the rate at
    which it ends, the second at which it must be over (asked before each step, as it may come nearer), the part of it
    without progress after which it has converged, and the phase's steps before and in all, if it is but a part."""

    phase: str
    steps: int
    final_rate: float
    until: Until = never
    patience: float = 0.3
    before: int = 0
    in_all: int | None = None

    def run(self, recorder: Recorder, step: Step, shown: Callable[[], float] | None = None) -> int:
        """Repeat step(rate, progress) -> (mse, counts); returns the steps done.

        The rate falls along a cosine from 1 to final_rate. Progress follows the steps or the time, whichever is
        further, so that a time limit shortens the schedule instead of cutting it off. The phase ends early when the
        error has stopped falling. shown measures the error that the trace is to show, in place of the step's.
        """
        begun = recorder.clock.seconds()
        best, best_at, done = math.inf, 0.0, 0
        in_all = self.in_all or self.steps
        progress = 0.0
        while progress < 1:
            rate = self.final_rate + (1 - self.final_rate) * 0.5 * (1 + math.cos(math.pi * progress))
            mse, counts = step(rate, progress)
            done += 1
            progress = done / self.steps
            until_s = self.until()
            if until_s is not None:
                progress = max(progress, (recorder.clock.seconds() - begun) / max(until_s - begun, 1e-9))
            at = self.before + (done if progress < 1 else self.steps)
            recorder.report(self.phase, at, in_all, shown or mse, counts)
            if mse < best * 10 ** (-PROGRESS_DB / 10):
                best, best_at = mse, progress
            elif progress - best_at > self.patience:
                break
            if mse < PERFECT_MSE:
                break
        return done
