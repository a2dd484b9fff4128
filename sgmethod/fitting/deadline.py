"""Time: how long an encode may take, and how much of the schedule fits. Nobody else reads a clock."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial

from sgmethod.backend.protocol import thread_count
from sgmethod.settings.rd import DeadlineSettings
from sgmethod.trace import Stop


class Clock:
    """Seconds since the encode began, and the second at which it was asked to stop."""

    def __init__(self, stop: Stop | None = None) -> None:
        self._start, self._stop, self._stopped_s = time.perf_counter(), stop, math.inf

    def seconds(self) -> float:
        """Since the start."""
        return time.perf_counter() - self._start

    def stopped_s(self) -> float:
        """When the stop was first seen; infinity before."""
        if self._stop is not None and math.isinf(self._stopped_s) and self._stop():
            self._stopped_s = self.seconds()
        return self._stopped_s


class Deadline:
    """The end of one encode, or of a part of it."""

    def __init__(
        self, clock: Clock, limit_s: float | None = None, pixels: int = 0, settings: DeadlineSettings | None = None
    ) -> None:
        """limit_s: of the whole encode, for a picture of this size."""
        self._clock, self.settings = clock, settings or DeadlineSettings()
        s = self.settings
        reserve_s = s.reserve_s_per_megapixel + s.shared_s_per_megapixel / thread_count()
        self._end_s = math.inf if limit_s is None else limit_s - s.reserve_s - reserve_s * pixels / 1e6
        self._began_s = clock.seconds()

    def part(self, share: float) -> Deadline:
        """That of a part which ends with this share of the whole time."""
        part = Deadline(self._clock, None, 0, self.settings)
        part._end_s = self._end_s if math.isinf(self._end_s) else share * self._end_s
        return part

    def part_from_now(self, share: float) -> Deadline:
        """That of a part which takes this share of the time left."""
        part = Deadline(self._clock, None, 0, self.settings)
        part._end_s = part._began_s + share * (self._until_s(1.0) - part._began_s)
        return part

    def left_s(self, share: float = 1.0) -> float:
        """Seconds until that share of the time is over, 0 once it is; infinity without a limit."""
        return max(self._until_s(share) - self._clock.seconds(), 0.0)

    def tries(self, most: int) -> Iterator[int]:
        """0, 1, ... as long as another try, which takes as long as the longest so far, ends in time; once at least."""
        longest_s = 0.0
        for number in range(most):
            if number > 0 and longest_s >= self.left_s():
                break
            began_s = self._clock.seconds()
            yield number
            longest_s = max(longest_s, self._clock.seconds() - began_s)

    def is_short(self) -> bool:
        """Whether little time is left for the fit, compared with that so far."""
        took_s = self._clock.seconds() - self._began_s
        return self.left_s(self.settings.fit_share) < self.settings.short * took_s

    def steps_in_time(self, gradient_s: float) -> float:
        """Steps of a fit that its time is enough for, if a gradient takes so long at the start; there are more
        Gaussians later."""
        return self.left_s(self.settings.fit_share) / (self.settings.gradients_per_step * gradient_s)

    def seconds_of(self, task: Callable[[], object]) -> float:
        """What a task takes, the fastest of three: the first also touches new memory."""
        times = []
        for _ in range(3):
            began_s = self._clock.seconds()
            task()
            times.append(self._clock.seconds() - began_s)
        return min(times)

    def has_limit(self) -> bool:
        """Whether time is limited now, by a limit or a stop."""
        return math.isfinite(self.left_s())

    def runs(self, lengths: Sequence[int]) -> Iterator[Pace]:
        """A pace for each run of the schedule, of so many steps: the first in any case, and further ones as long as
        they end in time."""
        prepared_s = self._clock.seconds()
        least_until_s = prepared_s + self.settings.least_part * (prepared_s - self._began_s)
        step_s = 0.0
        for number, length in enumerate(lengths):
            if number > 0 and step_s * length >= self.left_s(self.settings.fit_share):
                break
            began_s = self._clock.seconds()
            yield Pace(self._clock, length, partial(self._run_until_s, least_until_s if number == 0 else 0.0))
            step_s = (self._clock.seconds() - began_s) / length

    def pace(self, steps: int) -> Pace:
        """That of one run of so many steps."""
        return Pace(self._clock, steps, lambda: self._until_s(1.0))

    def _run_until_s(self, least_s: float) -> float:
        return max(self._until_s(self.settings.fit_share), least_s)

    def _until_s(self, share: float) -> float:
        """A stop is a limit that comes late: the rest of the schedule is shortened, not cut off."""
        stopped_s = self._clock.stopped_s()
        s = self.settings
        winding_down_s = min(s.winding_down * stopped_s, s.most_winding_down_s)
        return min(share * self._end_s, stopped_s + share * winding_down_s)


def cosine(final_rate: float, progress: float) -> float:
    """The rate of a schedule: along a cosine from 1 to the final one."""
    return final_rate + (1 - final_rate) * 0.5 * (1 + math.cos(math.pi * progress))


class Pace:
    """Progress through one run of the schedule, 0 to 1: by steps or by time, whichever is further, so that a time limit
    shortens the schedule instead of cutting it off."""

    def __init__(self, clock: Clock, steps: int, until_s: Callable[[], float]) -> None:
        self._clock, self._until_s = clock, until_s
        self._began_s = clock.seconds()
        self.length, self.done, self.progress = steps, 0, 0.0

    def until(self, end: float) -> Iterator[float]:
        """The progress before each step, until it reaches `end`."""
        while self.progress < min(end, 1.0):
            yield self.progress
            self.done += 1
            self.progress = self.done / self.length
            end_s = self._until_s()
            if math.isfinite(end_s):
                gone = (self._clock.seconds() - self._began_s) / max(end_s - self._began_s, 1e-9)
                self.progress = max(self.progress, gone)
