"""Time: a limit shortens the schedule, which is made for what is left."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from unittest.mock import patch

import numpy as np
import pytest

from sgmethod import Budget, codec, decode
from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Frame, Target, Visibility
from sgmethod.fitting import moving_target
from sgmethod.fitting.deadline import MIN_ROUND, SEARCH_CODINGS, SEARCH_SHARE, Clock, Deadline
from sgmethod.rd import schedule
from sgmethod.rd.byte_limit import CROWD, CROWD_WHEN_SHORT
from sgmethod.rd.densify import place
from sgmethod.rd.schedule import HASTY, SPARE_STEPS, fit_to_steps, planned, sized
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import EFFORTS, RD, Effort
from tests.definitions.backend import step_by_step
from tests.rd.short import Begun, SlowClock, asked, short
from tests.support.pictures import photo
from tests.support.profiles import encode_with

CROP = np.ascontiguousarray(photo()[24:72, 40:104])
NOISE = np.random.default_rng(0).integers(0, 256, (128, 160, 3), np.uint8)
PIXEL_S = 1e-6


@pytest.mark.parametrize("budget", [Budget("bytes", 400), Budget("psnr", 24), Budget("quality", 50)])
def test_a_time_limit_shortens_the_schedule(budget: Budget, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(codec, "Clock", SlowClock)
    monkeypatch.setattr(moving_target, "EVERY", 6)  # at most as many steps between two looks at the clock
    limited = partial(encode_with, short(240), CROP, budget)
    encoded = limited(time_limit_s=2.0)
    assert decode(encoded.data).shape == CROP.shape
    assert 40 < encoded.stats.steps < 120
    assert encoded.stats.seconds < 2.1
    if budget.kind == "bytes":
        assert 0.9 * 400 <= len(encoded.data) <= 400
    assert limited(time_limit_s=1e-9).stats.steps < 3


class WorkClock(Clock):
    """On which time goes by with work alone."""

    now = 0.0

    def seconds(self) -> float:
        return self.now


class Timed(Kernels):
    """Kernels whose gradients take PIXEL_S for each pixel, and any_s for any picture."""

    def __init__(self, clock: WorkClock, any_s: float) -> None:
        self._clock, self._any_s = clock, any_s

    steps = step_by_step

    def gradients(
        self, gaussians: Gaussians, frame: Frame, target: Target, visibility: Visibility | None = None
    ) -> tuple[float, Gaussians]:
        self._clock.now += self._any_s + PIXEL_S * frame.height * frame.width
        return super().gradients(gaussians, frame, target, visibility)


def begun_for(seconds: float, any_s: float = 0.0) -> Begun:
    """For 160 x 128 pixels, with this many seconds left to fit once gradients are timed."""
    clock = WorkClock()
    spent_s = 3 * (any_s + PIXEL_S * NOISE[..., 0].size)
    reserve_s = 1 - Deadline.from_limit(clock, 1.0).left_s()
    limit_s = (seconds + spent_s) / (1 - SEARCH_SHARE) + reserve_s
    deadline = Deadline.from_limit(clock, limit_s)
    unplanned = asked(NOISE, Budget("bytes", 2000), deadline=deadline, backend=Timed(clock, any_s))
    gaussians = place(unplanned.levels, unplanned.rate)
    clock.now = 0.0
    with patch.object(schedule, "SEARCH_GRADIENTS", (0.0, 0.0, 0.0)):
        levels, rate, runs = planned(unplanned.levels, unplanned.rate, deadline, gaussians)
    return Begun(levels, rate, runs, levels.begin(gaussians, rate.quantum), unplanned.session.recorder)


def test_a_short_time_limit_is_for_a_smaller_picture() -> None:
    short_of_time, unhurried = (begun_for(seconds) for seconds in (0.0, math.inf))
    assert unhurried.schedule.effort == unhurried.levels.effort == RD.effort
    assert short_of_time.schedule.effort == short_of_time.levels.effort == HASTY
    assert [vars(one.rate)["crowd"] for one in (unhurried, short_of_time)] == [CROWD, CROWD_WHEN_SHORT]
    levels, state = short_of_time.levels, short_of_time.state
    assert (levels.finest.frame.width, unhurried.levels.finest.frame.width) == (20, 160)
    stage = short_of_time.stage(100, at=EFFORTS[1].times.growth_at[0])
    assert levels.level_for(state, stage, 1000).frame == levels.finest.frame
    grown = short_of_time.grown(stage).fitted(stage).state
    added = grown.gaussians.means  # found in the small picture, but in pixels of the whole
    assert len(added) > len(state.gaussians)
    assert added[:, 0].max() > 80
    assert added[:, 1].max() > 64
    assert grown.gaussians.factors[:, 0::2].min() >= 8 * RD.optimiser.min_scale_px


def test_a_smaller_picture_is_fitted_only_as_far_as_it_saves_time() -> None:
    whole_s = PIXEL_S * NOISE[..., 0].size
    steps = begun_for(0.0).schedule.lengths[0]
    for in_time, halvings in ((1.1, 0), (0.3, 1), (0.1, 2), (0.01, 3)):
        levels = begun_for(in_time * steps * whole_s).levels
        assert levels.finest.frame.spacing == 1 << halvings
    for part, halvings in ((1.0, 0), (0.1, 2)):  # of what all pixels take, for any picture
        levels = begun_for(0.0, part * whole_s).levels
        assert levels.finest.frame.spacing == 1 << halvings


def test_a_fit_that_is_late_takes_some_steps_all_the_same() -> None:
    """If preparing it took long, as for a large picture, it gets a third of that time."""
    steps = []
    for prepared_s in (0.0, 6.0):
        clock = SlowClock()
        deadline = Deadline.from_limit(clock, 1e-9)
        clock.now += prepared_s
        steps.append(sum(1 for pace in deadline.runs([1000, 400]) for _ in pace.until(1.0)))
    assert steps[0] < 3
    assert steps[1] == pytest.approx(200, abs=3)  # looks at the clock, one for each step


@pytest.mark.parametrize("pixels", [400_000, 8_000_000])
def test_a_time_limit_too_short_for_an_effort_takes_a_lower_one(pixels: int) -> None:
    two, three, five = (sized(EFFORTS[effort], pixels) for effort in (2, 3, 5))
    hasty = sized(HASTY, pixels)
    all_steps = five.steps

    def filled(chosen: Effort, steps: int) -> tuple[Effort, bool]:
        """As many steps as the estimate may be short of."""
        return replace(chosen, steps=steps), False

    assert [fit_to_steps(five, pixels, steps) for steps in (math.inf, all_steps)] == 2 * [(five, False)]
    assert fit_to_steps(five, pixels, all_steps - 1) == filled(three, all_steps)
    assert fit_to_steps(five, pixels, three.steps - 1) == filled(two, all_steps)
    fewer = two.steps - 1
    assert fit_to_steps(five, pixels, fewer) == filled(hasty, min(round(SPARE_STEPS * fewer), all_steps))
    assert fit_to_steps(two, pixels, three.steps) == (two, False)
    fewest = hasty.steps // 4
    assert [fit_to_steps(fit, pixels, fewest) for fit in (five, two, hasty)] == 3 * [(hasty, True)]


def test_a_time_limit_leaves_the_search_its_part() -> None:
    """A tenth of it, or more where drawings of the whole picture and trial codings take longer."""
    clock = WorkClock()
    deadline = Deadline.from_limit(clock, 10.0)
    whole_s = deadline.left_s()
    assert deadline.left_to_fit_s() == pytest.approx((1 - SEARCH_SHARE) * whole_s)
    assert replace(deadline, drawings_s=4.0).left_to_fit_s() == pytest.approx(whole_s - 4)

    def code() -> str:
        clock.now += 0.25
        return "coded"

    assert deadline.coded(code) == "coded"
    clock.now = 0.0
    assert deadline.left_to_fit_s() == pytest.approx(whole_s - 0.25 * SEARCH_CODINGS)


def test_a_round_is_as_long_as_there_is_time_for() -> None:
    clock = WorkClock()
    deadline = Deadline.from_limit(clock, 10.0)
    lengths = []
    for pace in deadline.runs([100, 80, 80]):
        lengths.append(pace.length)
        for _ in pace.until(1.0):
            clock.now += 0.06
    assert lengths[0] == 100
    assert len(lengths) == 2  # the third would have less than the least part of its steps
    assert MIN_ROUND * 80 <= lengths[1] < 80


def test_large_pictures_are_spared_steps() -> None:
    small, *others, large = (sized(RD.effort, pixels) for pixels in (400_000, 2_000_000, 4_000_000, 8_000_000))
    assert small == RD.effort
    assert large == sized(RD.effort, 50_000_000)
    found = [(one.steps, -one.times.few_until) for one in (small, *others, large)]
    assert sorted(found, reverse=True) == found
    assert len(set(found)) == 4
    quick = EFFORTS[1]
    assert sized(quick, 8_000_000).times == quick.times  # which see small pictures for longer as it is
