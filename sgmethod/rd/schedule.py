"""Schedule: the runs of an encode, their steps and times, and how much of them fits into the available time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from sgmethod.fitting.deadline import GRADIENTS_PER_STEP, Deadline, Pace
from sgmethod.fitting.level import Level
from sgmethod.rd.levels import Levels
from sgmethod.rd.rate_control import RateControl
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import EFFORTS, ROUND, Effort, Times

DENSE_STEPS = 2.25  # factor on the steps for many Gaussians per pixel, which converge more slowly
SPARSE, DENSE = 0.01, 0.035  # Gaussians per pixel up to which an effort's steps are enough, and from which they are few
LARGE = (1e6, 8e6)  # pixels; between them the next two are phased in
LARGE_STEPS = 0.85  # factor on the steps for a large picture, whose last steps gain least for their time
LARGE_FEW_UNTIL = 0.8  # Times.few_until of a large picture, if later
ROUND_STEPS = 0.4  # in multiples of the first run's
# Least time for the search, in gradients with few Gaussians: drawings of the whole picture, its texture, and drawings
# of the finest level.
SEARCH_GRADIENTS = (4.0, 7.0, 6.0)
# Least time left for a level to be the finest, in gradients on it, and more if its target moves and loses grain.
FINEST_GRADIENTS = (25.0, 70.0)
HASTY = replace(EFFORTS[1], steps=75)  # for time that is too short for the lowest effort
SPARE_STEPS = 2.0  # steps planned, in multiples of those expected: the limit is what ends them


@dataclass(frozen=True)
class Schedule:
    """The runs of an encode: a first one, then the effort's rounds, and further ones for a quality that is missed."""

    deadline: Deadline
    effort: Effort
    first_steps: int
    further_rounds: int

    @property
    def lengths(self) -> list[int]:
        """Steps of the first run and of each round, including rounds for a quality that is missed."""
        a_round = max(round(ROUND_STEPS * self.first_steps), 1)
        return [self.first_steps, *[a_round] * (self.effort.rounds[-1] + self.further_rounds)]

    def all_steps(self, done: int, retaken: int = 0) -> int:
        """Expected steps of the encode, given those done: rounds for a missed quality count once they have begun.

        retaken: those that were taken again, which come on top.
        """
        expected = sum(self.lengths[: self.effort.rounds[-1] + 1]) + retaken
        return expected if done <= expected else sum(self.lengths) + retaken

    def times(self, run: int) -> Times:
        """Times of a run: 0 is the first, others are rounds."""
        rounds = self.effort.rounds
        times = self.effort.times if run == 0 else ROUND
        if run < rounds[-1]:
            times = replace(times, many_from=1.0)
        makes_file = run in rounds or run > rounds[-1]
        return times if makes_file else replace(times, settling_from=1.0)

    def runs(self) -> Iterator[tuple[int, Pace, Times]]:
        """Yield the number, pace and times of each run that there is time for."""
        for number, pace in enumerate(self.deadline.runs(self.lengths)):
            yield number, pace, self.times(number)


def planned(
    levels: Levels, rate: RateControl, deadline: Deadline, gaussians: Gaussians
) -> tuple[Levels, RateControl, Schedule]:
    """Adapt effort and sizes to the picture and to the time left, once the first Gaussians are placed.

    If time is too short for all steps, the schedule is that of a lower effort, with the steps that fill the time. If
    that takes too long as well, a smaller picture is fitted. The time of a gradient is measured here.
    """
    levels = replace(levels, effort=sized(levels.effort, levels.usual.pixels))
    if deadline.has_limit():
        levels, rate, deadline = _in_time(levels, rate, deadline, gaussians)
    steps = first_run(levels.effort, rate)
    return levels, rate, Schedule(deadline, levels.effort, steps, rate.further_rounds)


def first_run(effort: Effort, rate: RateControl) -> int:
    """Steps of the first run."""
    density = rate.expected_gaussians() / rate.pixels
    share = min(max((density - SPARSE) / (DENSE - SPARSE), 0), 1)
    return round(effort.steps * (1 + share * (DENSE_STEPS - 1)))


def _in_time(
    levels: Levels, rate: RateControl, deadline: Deadline, gaussians: Gaussians
) -> tuple[Levels, RateControl, Deadline]:
    """Reduce effort, Gaussians and levels to the time left, of which the search has its part.

    Computing the gradient on the finest level takes no longer than a step may. A coarser level is used only if it
    halves the time, because it lacks detail. A level finer than the usual one is used if its drawings leave time for
    steps.
    """
    usual, pyramid, effort, objective = levels.usual, levels.pyramid, levels.effort, levels.problem.objective

    def gradient_s(level: Level) -> float:
        return deadline.seconds_of(lambda: level.gradients(gaussians))

    took_s = gradient_s(usual)
    pixel_s, hides = took_s / usual.pixels, objective.replaces_grain
    of_whole, of_texture, of_finest = SEARCH_GRADIENTS
    as_finest = FINEST_GRADIENTS[0] + FINEST_GRADIENTS[1] * hides

    def searching(finest: Level) -> Deadline:
        pixels = (of_whole + of_texture * hides) * objective.pixels.size / 3 + of_finest * finest.pixels
        return replace(deadline, drawings_s=pixel_s * pixels)

    finer = [level for level in pyramid.levels if level.pixels > usual.pixels]
    affordable = (one for one in finer if as_finest * pixel_s * one.pixels <= searching(one).left_to_fit_s())
    finest = next(affordable, usual)
    later = searching(finest)
    in_time = later.steps_in_time(took_s)
    effort, is_short = fit_to_steps(effort, usual.pixels, in_time / first_run(effort, rate) * effort.steps)
    step_s = took_s * in_time * GRADIENTS_PER_STEP / first_run(effort, rate)
    for level in pyramid.from_level(usual).levels[1:]:
        if took_s <= step_s:
            break
        took_s, before_s = gradient_s(level), took_s
        if took_s > before_s / 2:
            break
        finest = level
    levels = replace(levels, effort=effort, pyramid=pyramid.from_level(finest))
    return levels, rate.with_fewer() if is_short else rate, later


def sized(effort: Effort, pixels: int) -> Effort:
    """Adapt an effort to this many pixels: a large picture gets fewer steps, and reduced pictures for longer."""
    small, large = LARGE
    share = min(max(math.log(pixels / small) / math.log(large / small), 0.0), 1.0)
    later = max(LARGE_FEW_UNTIL - effort.times.few_until, 0.0)
    times = replace(effort.times, few_until=effort.times.few_until + share * later)
    return replace(effort, steps=round(effort.steps * (1 - share * (1 - LARGE_STEPS))), times=times)


def fit_to_steps(effort: Effort, pixels: int, steps: float) -> tuple[Effort, bool]:
    """Reduce an effort, already sized(), to a number of steps. Also whether even HASTY takes too many.

    The effort stays if it fits, else it becomes the highest lower effort that fits, or HASTY, with as many steps as
    there may be time for.
    """
    spare = min(round(SPARE_STEPS * steps), effort.steps) if steps < math.inf else 0
    lower = [sized(one, pixels) for one in (*reversed(EFFORTS.values()), HASTY) if one.rounds == (0,)]
    choices = [effort, *(one for one in lower if one.steps <= effort.steps)]
    found = next((one for one in choices if one.steps <= steps), choices[-1])
    return replace(found, steps=max(found.steps, spare)), found.steps > steps
