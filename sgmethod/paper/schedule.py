"""The schedule of a phase of a fit: the falling rate, and the end of the phase."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from sgmethod.fitting.deadline import Deadline, cosine
from sgmethod.fitting.recorder import Recorder

PERFECT_MSE = 1e-7  # 70 dB: a tenth of the error of rounding to 8 bits
PROGRESS_DB = 0.01  # the least improvement that counts as progress

Step = Callable[[float], tuple[float, int, int]]  # rate -> (mse, Gaussians, bytes of the file or 0)


@dataclass(frozen=True)
class Schedule:
    """One phase of an encode.

    phase: its name in the trace; final_rate: factor on the rates at its end; patience: the part of the schedule without
    progress after which the phase has converged.
    """

    phase: str
    steps: int
    final_rate: float
    patience: float

    def run(self, deadline: Deadline, recorder: Recorder, step: Step) -> int:
        """Repeat a step while there is time; return the number of steps done.

        The rate falls along a cosine from 1 to final_rate. The phase ends early once the error has stopped falling.
        """
        best, best_at = math.inf, 0.0
        pace = deadline.pace(self.steps)
        for progress in pace.until(1.0):
            mse, gaussians, size = step(cosine(self.final_rate, progress))
            recorder.report(self.phase, pace.done + 1, self.steps, mse, gaussians, size)
            if mse < best * 10 ** (-PROGRESS_DB / 10):
                best, best_at = mse, progress
            elif progress - best_at > self.patience:
                break
            if mse < PERFECT_MSE:
                break
        return pace.done + (pace.progress < 1)
