"""Error against time, as an encode goes on."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from copy import copy

from sgmethod.trace import Preview, Progress, Stop, TracePoint, shown_to_nobody

REPORT_INTERVAL_S = 0.1


class Clock:
    """Seconds since the encode began, its limit, and whether somebody wants it to stop, which stop() tells."""

    def __init__(self, limit_s: float | None = None, stop: Stop | None = None) -> None:
        self.start = time.perf_counter()
        self.limit_s = limit_s
        self._stop = stop
        self._stopped_s: float | None = None

    def seconds(self) -> float:
        """Seconds since the start."""
        return time.perf_counter() - self.start

    def stopped_s(self) -> float | None:
        """The second at which it was first seen that the encode is to stop; None before."""
        if self._stopped_s is None and self._stop is not None and self._stop():
            self._stopped_s = self.seconds()
        return self._stopped_s


class Recorder:
    """Collects the trace and hands it on, at most every REPORT_INTERVAL_S."""

    def __init__(self, clock: Clock, on_progress: Progress | None, on_preview: Preview | None = None) -> None:
        self.clock, self.on_progress = clock, on_progress
        self.preview = on_preview or shown_to_nobody
        self.points: list[TracePoint] = []
        self._interval_s = REPORT_INTERVAL_S

    def previewing(self, preview: Preview) -> Recorder:
        """The same, with another preview."""
        other = copy(self)
        other.preview = preview
        return other

    def report(
        self, phase: str, step: int, steps: int, mse: float | Callable[[], float], counts: tuple[int, int]
    ) -> None:
        """Add a point, where one is due. mse: the error, or what measures it for the trace alone, which takes no more
        than a twentieth of the time; counts = (number of Gaussians, bits of the file or 0)."""
        seconds = self.clock.seconds()
        new_phase = not self.points or self.points[-1].phase != phase
        if not (new_phase or step == steps or seconds - self.points[-1].seconds >= self._interval_s):
            return
        if callable(mse):
            mse = mse()
            self._interval_s = max(REPORT_INTERVAL_S, 20 * (self.clock.seconds() - seconds))
        psnr = -10 * math.log10(max(mse, 1e-12))
        gaussians, bits = counts
        point = TracePoint(round(seconds, 4), step, steps, round(psnr, 4), -(-bits // 8), gaussians, phase)
        self.points.append(point)
        if self.on_progress:
            self.on_progress(point)
