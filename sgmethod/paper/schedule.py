"""The schedule of a phase of a fit: the falling rate, and the end of the phase."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sgmethod.fitting.deadline import Deadline, cosine
from sgmethod.fitting.recorder import Recorder

PERFECT_MSE = 1e-7  # 70 dB: a tenth of the error of rounding to 8 bits

Step = Callable[[float], tuple[float, int, int]]  # rate -> (mse, Gaussians, bytes of the file or 0)


@dataclass(frozen=True)
class Schedule:
    """One phase of an encode.

    phase: its name in the trace; final_rate: factor on the rates at its end.
    """

    phase: str
    steps: int
    final_rate: float

    def run(self, deadline: Deadline, recorder: Recorder, step: Step) -> int:
        """Repeat a step while there is time; return the number of steps done.

        The rate falls along a cosine from 1 to final_rate. The phase ends early only if hardly any error is left.
        """
        pace = deadline.pace(self.steps)
        for progress in pace.until(1.0):
            mse, gaussians, size = step(cosine(self.final_rate, progress))
            recorder.report(self.phase, pace.done + 1, self.steps, mse, gaussians, size)
            if mse < PERFECT_MSE:
                break
        return pace.done + (pace.progress < 1)
