"""Deadlines: how long an encode may take, and how much of the schedule fits.

No other module of the fit reads a clock.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import takewhile
from typing import TypeVar

from sgmethod.backend.protocol import thread_count

Result = TypeVar("Result")
STEPS_S = 0.05  # duration of steps that are taken together
# Reserved for writing and measuring the file; the shared part is divided by the number of threads.
RESERVE_S = 0.005
RESERVE_S_PER_MEGAPIXEL, SHARED_S_PER_MEGAPIXEL = 0.002, 0.015
SEARCH_SHARE = 0.1  # of the limit, for the search over the file's integers, or more if drawings and codings take longer
SEARCH_CODINGS = 8.0  # trial codings of a search
GRADIENTS_PER_STEP = 4.0  # duration of a step, in gradients timed at the start with few Gaussians
MIN_ROUND = 0.3  # of a round's steps, for which it is begun
SHORT = 4.0  # in multiples of the time for the pyramid; with less left, growth searches few pixels
MIN_PART = 1 / 3  # least time for the first run, as a part of the time for preparing, even beyond a limit


class Clock:
    """A stopwatch of an encode."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    def seconds(self) -> float:
        """Seconds since the encode began."""
        return time.perf_counter() - self._start


@dataclass(frozen=True)
class Deadline:
    """The deadline of an encode, or of a part of it: seconds of its clock at which it begins and ends."""

    clock: Clock
    began_s: float
    end_s: float
    drawings_s: float = 0.0  # of the search over the file's integers, before any of its files
    _coding_s: list[float] = field(default_factory=list)  # duration of the last trial coding

    @classmethod
    def from_limit(cls, clock: Clock, limit_s: float | None = None, pixels: int = 0) -> Deadline:
        """Start an encode. limit_s: for the whole encode, including a reserve for measuring this many pixels."""
        reserve_s = RESERVE_S_PER_MEGAPIXEL + SHARED_S_PER_MEGAPIXEL / thread_count()
        end_s = math.inf if limit_s is None else limit_s - RESERVE_S - reserve_s * pixels / 1e6
        return cls(clock, clock.seconds(), end_s)

    def at(self, share: float) -> Deadline:
        """A deadline at `share` (above 0) of the total time."""
        return replace(self, began_s=self.clock.seconds(), end_s=share * self.end_s)

    def after(self, share: float) -> Deadline:
        """A deadline after `share` of the time left."""
        now_s = self.clock.seconds()
        return replace(self, began_s=now_s, end_s=now_s + share * (self.end_s - now_s))

    def left_s(self) -> float:
        """Seconds left, at least 0; infinity without a limit."""
        return max(self.end_s - self.clock.seconds(), 0.0)

    def left_to_fit_s(self) -> float:
        """Seconds left, without those for the search over the file's integers."""
        return max(self._fit_until_s() - self.clock.seconds(), 0.0)

    def coded(self, task: Callable[[], Result]) -> Result:
        """Code a fit, and note how long that takes: the search will do so several times."""
        began_s = self.clock.seconds()
        found = task()
        self._coding_s[:] = [self.clock.seconds() - began_s]
        return found

    def grown(self, times: float) -> None:
        """Expect that the next coding takes so many times as long as the last."""
        self._coding_s[:] = [times * one for one in self._coding_s]

    def has_time_for_codings(self, codings: float) -> bool:
        """Whether there is time for so many codings, as far as is known."""
        return self.left_s() > codings * sum(self._coding_s)

    def attempts(self, limit: int) -> Iterator[int]:
        """Yield 0, 1, ... while there is time for another try as long as the longest so far; 0 in any case."""
        max_s = 0.0
        for number in range(limit):
            if number > 0 and max_s >= self.left_s():
                break
            began_s = self.clock.seconds()
            yield number
            max_s = max(max_s, self.clock.seconds() - began_s)

    def is_short(self) -> bool:
        """Whether little time is left for the fit, compared with the time so far."""
        took_s = self.clock.seconds() - self.began_s
        return self.left_to_fit_s() < SHORT * took_s

    def steps_in_time(self, gradient_s: float) -> float:
        """Estimate the steps that a fit has time for, from the duration of a gradient at its start."""
        return self.left_to_fit_s() / (GRADIENTS_PER_STEP * gradient_s)

    def seconds_of(self, task: Callable[[], object]) -> float:
        """Time a task: the fastest of three runs, because the first also touches new memory."""
        times = []
        for _ in range(3):
            began_s = self.clock.seconds()
            task()
            times.append(self.clock.seconds() - began_s)
        return min(times)

    def has_limit(self) -> bool:
        """Whether time is limited."""
        return math.isfinite(self.end_s)

    def runs(self, lengths: Sequence[int]) -> Iterator[Pace]:
        """Yield a pace for each run of these lengths: the first in any case, others as far as there is time."""
        prepared_s = self.clock.seconds()
        min_until_s = prepared_s + MIN_PART * (prepared_s - self.began_s)
        step_s = 0.0
        for number, length in enumerate(lengths):
            if number > 0:
                in_time = int(min(self.left_to_fit_s() / step_s, length))
                if in_time < MIN_ROUND * length:
                    break
                length = in_time
            began_s = self.clock.seconds()
            yield Pace(self, length, partial(self._run_until_s, min_until_s if number == 0 else 0.0))
            step_s = (self.clock.seconds() - began_s) / length

    def pace(self, steps: int) -> Pace:
        """A pace for one run of this many steps."""
        return Pace(self, steps, lambda: self.end_s)

    def _run_until_s(self, least_s: float) -> float:
        return max(self._fit_until_s(), least_s)

    def _fit_until_s(self) -> float:
        """Second at which the search begins."""
        search_s = self.drawings_s + SEARCH_CODINGS * sum(self._coding_s)
        return min((1 - SEARCH_SHARE) * self.end_s, self.end_s - search_s)


def cosine(final_rate: float, progress: float) -> float:
    """Rate of a schedule, along a cosine from 1 to final_rate."""
    return final_rate + (1 - final_rate) * 0.5 * (1 + math.cos(math.pi * progress))


class Pace:
    """Progress through a run, 0 to 1, by steps or by time, whichever is further: a limit shortens the schedule."""

    def __init__(self, deadline: Deadline, steps: int, until_s: Callable[[], float]) -> None:
        self._clock, self._until_s = deadline.clock, until_s
        self._began_s = self._clock.seconds()
        self.grown = deadline.grown  # all that a fit, which knows no clock, tells it
        self.length, self.done, self.progress = steps, 0, 0.0

    def until(self, end: float) -> Iterator[float]:
        """Yield the progress before each step, until it reaches `end`."""
        while self.progress < min(end, 1.0):
            yield self.progress
            end_s = self._until_s()
            self._advance(1, self._clock.seconds() if math.isfinite(end_s) else 0.0, end_s)

    def together(self, end: float, limit: Callable[[], int]) -> Iterator[list[float]]:
        """Yield the progress before each of some steps, at most limit() at a time, until it reaches `end`.

        Progress is reported about every STEPS_S. If time is limited, each step comes alone.
        """
        end, step_s, seen_s, end_s = min(end, 1.0), math.inf, self._clock.seconds(), self._until_s()
        while self.progress < end:
            many = 1 if math.isfinite(end_s) else min(limit(), 1 + int(STEPS_S / step_s))
            further = (done / self.length for done in range(self.done + 1, self.done + many))
            steps = [self.progress, *takewhile(lambda progress: progress < end, further)]
            yield steps
            began_s, seen_s, end_s = seen_s, self._clock.seconds(), self._until_s()
            step_s = max((seen_s - began_s) / len(steps), 1e-6)
            self._advance(len(steps), seen_s, end_s)

    def _advance(self, steps: int, seen_s: float, end_s: float) -> None:
        """Count steps, done by second seen_s of a run that is to end at second end_s, if that is limited."""
        self.done += steps
        self.progress = self.done / self.length
        if math.isfinite(end_s):
            by_time = (seen_s - self._began_s) / max(end_s - self._began_s, 1e-9)
            self.progress = max(self.progress, by_time)
