"""Recording the trace of an encode: error against time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from sgmethod.fitting.deadline import Clock
from sgmethod.trace import Progress, TracePoint, share_of

REPORT_INTERVAL_S = 0.1


@dataclass(frozen=True)
class Recorder:
    """Collector of the trace: reports a point at most every REPORT_INTERVAL_S.

    tries: quanta that a search usually tries.
    """

    clock: Clock
    on_progress: Progress | None = None
    tries: int = 1
    points: list[TracePoint] = field(default_factory=list)
    _slow_s: list[float] = field(default_factory=list)  # duration of the last measurement for the trace

    def report(
        self,
        phase: str,
        step: int,
        steps: int,
        mse: float | Callable[[], float],
        gaussians: int,
        size: int = 0,
    ) -> None:
        """Add a point if one is due.

        mse: the error, or a function that measures it only for the trace, in at most a fiftieth of the time, or a
        twentieth if somebody watches; size: of the file in bytes, 0 while unknown.
        """
        seconds, multiple = self.clock.seconds(), 20 if self.on_progress else 50
        interval_s = max(REPORT_INTERVAL_S, multiple * self._slow_s[-1] if self._slow_s else 0.0)
        new_phase = not self.points or self.points[-1].phase != phase
        if not (new_phase or step == steps or seconds - self.points[-1].seconds >= interval_s):
            return
        if callable(mse):
            mse = mse()
            self._slow_s[:] = [self.clock.seconds() - seconds]
        psnr = -10 * math.log10(max(mse, 1e-12))
        share = round(share_of(phase, step, steps, self.tries), 4)
        point = TracePoint(round(seconds, 4), step, steps, round(psnr, 4), size, gaussians, phase, share)
        self.points.append(point)
        if self.on_progress:
            self.on_progress(point)
