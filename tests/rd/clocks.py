"""Clocks that are the same on every machine."""

from __future__ import annotations

from sgmethod.fitting.recorder import Clock
from sgmethod.trace import Stop


class SlowClock(Clock):
    """Each look at it takes a hundredth of a second."""

    def __init__(self, limit_s: float | None = None, stop: Stop | None = None) -> None:
        super().__init__(limit_s, stop)
        self.now = 0.0

    def seconds(self) -> float:
        """As Clock.seconds."""
        self.now += 0.01
        return self.now
