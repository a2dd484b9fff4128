"""Plan: the settings and picture sizes that fit into the available time; State: the progress of the fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.protocol import COARSE_SIDE, Descent, Moments, Target, Visibility
from sgmethod.fitting.bands import Rows
from sgmethod.fitting.deadline import GRADIENTS_PER_STEP, Deadline, Pace
from sgmethod.fitting.level import PIXELS_PER_GAUSSIAN, PIXELS_WHILE_FEW, Level, Pyramid
from sgmethod.fitting.moving_target import FitTarget, led
from sgmethod.rd.problem import Problem, Session
from sgmethod.rd.rate_control import RateControl, error_per_bit
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import EFFORTS, ROUND, RdSettings, Times

MANY_VALUES = 1 << 23  # samples of a level; work on a smaller one leaves little memory behind
DENSE_STEPS = 2.25  # factor on the steps for many Gaussians per pixel, which converge more slowly
SPARSE, DENSE = 0.01, 0.035  # Gaussians per pixel up to which an effort's steps are enough, and from which they are few
LARGE = (1e6, 8e6)  # pixels; between them the next two are phased in
LARGE_STEPS = 0.85  # factor on the steps for a large picture, whose last steps gain least for their time
LARGE_FEW_UNTIL = 0.8  # Times.few_until of a large picture, if later
ROUND_STEPS = 0.4  # in multiples of the first run's
# Samples: the energy of a narrower Gaussian depends on its position between the samples of a smaller picture.
NARROWEST = 0.75
# Least time for the search, in gradients with few Gaussians: drawings of the whole picture, its texture, and drawings
# of the finest level.
SEARCH_GRADIENTS = (4.0, 7.0, 6.0)
# Least time left for a level to be the finest, in gradients on it, and more if its target moves and loses grain.
FINEST_GRADIENTS = (25.0, 70.0)
SPARE_STEPS = 2.0  # steps planned, in multiples of those expected: the limit is what ends them
CROWD_WHEN_SHORT = 1.3  # RdSettings.crowd if time is too short for the lowest effort


@dataclass(frozen=True)
class Plan:
    """What all stages read: problem, settings, budget and session side by side, and the picture sizes.

    rate: what the budget allows.
    """

    problem: Problem
    settings: RdSettings
    rate: RateControl
    session: Session
    pyramid: Pyramid

    def in_time(self, gaussians: Gaussians) -> Plan:
        """Adapt settings and sizes to the picture and to the time left, once the first Gaussians are placed.

        If time is too short for all steps, the plan takes a lower effort, with the steps that fill the time. If
        that takes too long as well, a smaller picture is fitted. The time of a gradient is measured here.
        """
        s = self.settings
        usual = self.pyramid.coarsest(PIXELS_PER_GAUSSIAN * self.rate.expected_gaussians())
        plan = replace(self, settings=sized(s, usual.pixels))
        return (_in_time(plan, usual, gaussians) if self.session.deadline.has_limit() else plan).within_pixels()

    def within_pixels(self) -> Plan:
        """Set the scale below which a Gaussian would fall between the pixels of the finest level."""
        optimiser, spacing = self.settings.optimiser, self.finest.frame.spacing
        if spacing == 1:
            return self
        narrowest = max(NARROWEST, optimiser.min_scale_px) * spacing
        return replace(self, settings=replace(self.settings, optimiser=replace(optimiser, min_scale_px=narrowest)))

    @property
    def finest(self) -> Level:
        """The picture at the size that the file can show."""
        return self.pyramid.finest

    @cached_property
    def shown(self) -> Visibility | None:
        """Share of the finest level that alpha shows."""
        shown = self.problem.objective.shown
        for _ in range(self.finest.frame.spacing.bit_length() - 1):
            shown = shown and shown.half
        return shown

    @property
    def lengths(self) -> list[int]:
        """Steps of the first run and of each round, including rounds for a quality that is missed."""
        first = first_run(self.settings, self.rate)
        a_round = max(round(ROUND_STEPS * first), 1)
        further = self.rate.further_rounds
        return [first, *[a_round] * (self.settings.effort.rounds[-1] + further)]

    def all_steps(self, done: int, retaken: int = 0) -> int:
        """Expected steps of the encode, given those done: rounds for a missed quality count once they have begun.

        retaken: those that were taken again, which come on top.
        """
        expected = sum(self.lengths[: self.settings.effort.rounds[-1] + 1]) + retaken
        return expected if done <= expected else sum(self.lengths) + retaken

    def begin(self, gaussians: Gaussians) -> State:
        """Return the state before the first step."""
        finest, background = self.finest, self.problem.background[0]
        target = self.problem.objective.moving_target(finest.target, finest.frame.spacing, background)
        return State(gaussians, Moments.none(len(gaussians)), self.rate.quantum, target)

    def level_for(self, state: State, stage: Stage, gaussians: int) -> Level:
        """Choose the level that this many Gaussians are fitted to: the coarsest that will do, in the end the finest."""
        progress, times = stage.pace.progress, stage.times
        if progress >= times.many_from:
            level = self.finest
        elif progress >= times.few_until:
            expected = max(gaussians, self.rate.expected_gaussians())
            level = self.pyramid.coarsest(PIXELS_PER_GAUSSIAN * expected)
        else:
            level = self.pyramid.coarsest(PIXELS_WHILE_FEW * gaussians)
        if stage.has_grown:
            level = self.problem.objective.with_coarse(level)
        return replace(level, target=state.target.now) if level.frame == self.finest.frame else level

    def aim(self, state: State) -> Aim:
        """Return what a search of this state aims at."""
        return Aim(self.refining_target(state), cache(partial(self.error, state.gaussians, state.quantum)))

    def at_rest(self, state: State) -> tuple[Plan, State]:
        """Return both for a search that no run follows: of all pictures, they keep the target of refining alone."""
        error = self.error(state.gaussians, state.quantum)  # by the picture, which goes
        target = self.refining_target(state, into=state.target.now)
        finest = replace(self.finest, target=target)
        pyramid = replace(self.pyramid, levels=(finest,), detailed=(finest,))
        state = replace(state, target=FitTarget(target, target), aim=Aim(target, lambda: error))
        return replace(self, pyramid=pyramid), state

    def refining_target(self, state: State, into: Target | None = None) -> Target:
        """Return the target of refining, which weighs each pixel alone: coarse errors move it, into memory if given."""
        shrink, level = COARSE_SIDE // (2 * self.finest.frame.spacing), self.problem.objective.with_coarse(self.finest)
        if shrink == 0 or level.visibility is None or level.visibility.coarse == 0:
            return state.target.now
        error = level.missing(state.gaussians, half=True)
        if self.problem.objective.shown is not None:
            error = _where(level.visibility.half.values > 0, error)
        return led(state.target.now, error, level.visibility.coarse, shrink, into)

    def descent(self, level: Level, quantum: float, price: float, step_length: float = 1.0) -> Descent:
        """Describe what steps on a level minimise.

        price: squared error of the whole picture that a bit costs; step_length: factor on the longest step.
        """
        price, optimiser = price / self.problem.pixels.size, self.settings.optimiser
        optimiser = replace(optimiser, newton_steps=step_length * optimiser.newton_steps)
        return Descent(level.frame, level.target, level.visibility, quantum, price, *self.problem.size, optimiser)

    def error(self, gaussians: Gaussians, quantum: float | None = None) -> float:
        """Mean squared error on the finest level; given a quantum, of Gaussians as they would decode."""
        backend, level = self.finest.backend, self.finest
        if quantum is not None:
            gaussians = backend.rounded(gaussians, self.problem.coding(quantum))
        return backend.error(gaussians, level.frame, level.target, self.shown)

    def psnr(self, gaussians: Gaussians, quantum: float | None = None) -> float:
        """PSNR on the finest level, in dB, as error() measures it."""
        return -10 * math.log10(max(self.error(gaussians, quantum), 1e-12))

    def allowed_gaussians(self, times: Times, at: float) -> int:
        """Limit on the number of Gaussians."""
        return self.rate.allowed_gaussians(times, at, self.settings.crowd)

    def times(self, run: int) -> Times:
        """Times of a run: 0 is the first, others are rounds."""
        rounds = self.settings.effort.rounds
        times = self.settings.effort.times if run == 0 else ROUND
        if run < rounds[-1]:
            times = replace(times, many_from=1.0)
        makes_file = run in rounds or run > rounds[-1]
        return times if makes_file else replace(times, settling_from=1.0)


def _where(shown: NDArray[np.bool_], error: Rows) -> Rows:
    """Leave out the error of samples that alpha hides. shown: [H, W] at half the size, as the error's planes."""
    return lambda first, end: error(first, end) * shown[first // 2 : -(-end // 2)]


def first_run(settings: RdSettings, rate: RateControl) -> int:
    """Steps of the first run."""
    density = rate.expected_gaussians() / rate.pixels
    share = min(max((density - SPARSE) / (DENSE - SPARSE), 0), 1)
    return round(settings.effort.steps * (1 + share * (DENSE_STEPS - 1)))


def _in_time(plan: Plan, usual: Level, gaussians: Gaussians) -> Plan:
    """Reduce settings and pyramid to the time left, of which the search has its part. usual: the level of most steps.

    Computing the gradient on the finest level takes no longer than a step may. A coarser level is used only if it
    halves the time, because it lacks detail. A level finer than `usual` is used if its drawings leave time for steps.
    """
    settings, pyramid, objective = plan.settings, plan.pyramid, plan.problem.objective
    deadline = plan.session.deadline

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
    deadline = searching(finest)
    in_time = deadline.steps_in_time(took_s)
    all_steps = first_run(settings, plan.rate)
    settings = fit_to_steps(settings, usual.pixels, in_time / all_steps * settings.effort.steps)
    step_s = took_s * in_time * GRADIENTS_PER_STEP / first_run(settings, plan.rate)
    for level in pyramid.from_level(usual).levels[1:]:
        if took_s <= step_s:
            break
        took_s, before_s = gradient_s(level), took_s
        if took_s > before_s / 2:
            break
        finest = level
    session = replace(plan.session, deadline=deadline)
    return replace(plan, session=session, settings=settings, pyramid=pyramid.from_level(finest))


def sized(settings: RdSettings, pixels: int) -> RdSettings:
    """Adapt settings to this many pixels: a large picture gets fewer steps, and reduced pictures for longer."""
    effort, (small, large) = settings.effort, LARGE
    share = min(max(math.log(pixels / small) / math.log(large / small), 0.0), 1.0)
    later = max(LARGE_FEW_UNTIL - effort.times.few_until, 0.0)
    times = replace(effort.times, few_until=effort.times.few_until + share * later)
    steps = round(effort.steps * (1 - share * (1 - LARGE_STEPS)))
    return replace(settings, effort=replace(effort, steps=steps, times=times))


def fit_to_steps(settings: RdSettings, pixels: int, steps: float) -> RdSettings:
    """Reduce settings, already sized(), to a number of steps.

    The effort stays if it fits, else it becomes the highest lower effort that fits, with as many steps as there may be
    time for, else the lowest with fewer Gaussians.
    """
    spare = min(round(SPARE_STEPS * steps), settings.effort.steps) if steps < math.inf else 0
    lower = [sized(replace(settings, effort=one), pixels) for one in reversed(EFFORTS.values()) if one.rounds == (0,)]
    choices = [settings, *(one for one in lower if one.effort.steps < settings.effort.steps)]
    few = replace(choices[-1], crowd=CROWD_WHEN_SHORT)
    found = next((one for one in choices if one.effort.steps <= steps), few)
    return replace(found, effort=replace(found.effort, steps=max(found.effort.steps, spare)))


@dataclass(frozen=True)
class Stage:
    """A part of a run: what is due at `at` is done once, then steps are taken until `until`."""

    pace: Pace
    times: Times
    at: float
    until: float
    is_due: bool = True

    @property
    def grows(self) -> bool:
        """Whether Gaussians are added."""
        return self.at in self.times.growth_at

    @property
    def has_grown(self) -> bool:
        """Whether the last growth of the run is over by now."""
        return self.pace.progress > self.times.growth_at[-1]


def stages(pace: Pace, times: Times) -> Iterator[Stage]:
    """Yield the stages of a run, except those that are over before they begin."""
    due = {*times.growth_at, *times.trim_at}
    for at, until in pairwise(sorted({0.0, *due, times.few_until, times.many_from, 1.0})):
        if pace.progress < until:
            yield Stage(pace, times, at, until, at in due)


@dataclass(frozen=True)
class Aim:
    """What refining aims at, and the mean squared error of the fit that it begins with, as it would decode."""

    target: Target
    error: Callable[[], float]


@dataclass(frozen=True)
class State:
    """The state of a fit.

    moments: those of the optimiser; target: the moving target of the finest level; steps: taken so far; size: estimated
    size of the file in bytes; saturated_price: price of a bit at which growth last found next to nothing; is_enough:
    see RateControl.is_enough(); step_length: factor on the longest step; retaken: steps that were taken again;
    aim: of the search, once no run follows it.
    """

    gaussians: Gaussians
    moments: Moments
    quantum: float
    target: FitTarget
    steps: int = 0
    size: int = 0
    saturated_price: float = np.inf
    is_enough: bool = False
    step_length: float = 1.0
    retaken: int = 0
    aim: Aim | None = None

    @property
    def bit_price(self) -> float:
        """Squared error that one bit is worth."""
        return error_per_bit(self.quantum)

    def rows(self, index: NDArray[np.intp]) -> State:
        """Return the state with only these Gaussians, in this order."""
        return replace(self, gaussians=self.gaussians.rows(index), moments=self.moments.rows(index))
