"""The steps of the pipeline one by one: what each makes of the state it is given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from sgmethod import Budget, decode
from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Descent, Moments
from sgmethod.bitstream import container
from sgmethod.fitting.deadline import Clock
from sgmethod.fitting.moving_target import ExaggeratedTarget
from sgmethod.fitting.recorder import Recorder
from sgmethod.rd.densify import prune_to_limit
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import RD
from tests.rd.short import asked, short
from tests.support.pictures import photo

CROP = np.ascontiguousarray(photo()[24:72, 40:104])
BUDGET = Budget("bytes", 2000)


@pytest.mark.parametrize("halvings", [0, 1])
def test_no_grain_is_hidden_where_a_smaller_picture_is_fitted(halvings: int) -> None:
    begun = asked(CROP, BUDGET, "visual").begun()
    assert isinstance(begun.state.target, ExaggeratedTarget)
    pyramid = begun.levels.pyramid
    levels = replace(begun.levels, pyramid=pyramid.from_level(pyramid.levels[halvings]))
    begun = replace(begun, levels=levels, state=levels.begin(begun.state.gaussians, begun.state.quantum))
    after = begun.fitted(begun.stage(100, at=0.99)).state
    assert after.target.hides == (halvings == 0)
    assert not begun.state.target.hides


class Swinging(Kernels):
    """Kernels whose steps multiply the error, or so they say, and that note how long a step may be."""

    def __init__(self, growth: float) -> None:
        self.growth = growth
        self.lengths: list[float] = []

    def steps(self, gaussians: Gaussians, moments: Moments, descent: Descent, rates: Sequence[float]) -> list[float]:
        super().steps(gaussians, moments, descent, rates)
        before, self.lengths = len(self.lengths), [*self.lengths, *len(rates) * [descent.settings.newton_steps]]
        return [self.growth**k for k in range(before, len(self.lengths))]


@pytest.mark.parametrize(("growth", "in_the_round"), [(1.2, {2.0}), (1.3, {2.0, 1.0})])
def test_a_round_that_comes_apart_goes_on_with_shorter_steps(growth: float, in_the_round: set[float]) -> None:
    """One of a photograph of 4 megapixels took 6 points of SSIMULACRA 2; a first run has time to recover."""
    backend, settings = Swinging(growth), short(60)
    given = asked(CROP, BUDGET, settings=settings, backend=backend)
    given.encode()
    first = given.begun().schedule.lengths[0]
    assert set(backend.lengths[:first]) == {2.0}
    assert set(backend.lengths[first:]) == in_the_round
    assert backend.lengths == sorted(backend.lengths, reverse=True)


def test_steps_that_come_apart_are_taken_again() -> None:
    """As far as there is time, from where they began; peony, of 4 megapixels, lost up to 0.2 dB by them."""
    backend = Swinging(1.3)
    begun = asked(CROP, BUDGET, "visual", backend=backend).begun()
    begun = begun.fitted(begun.stage(100))
    taken = len(backend.lengths)
    stage = begun.stage(100)
    after = begun.fitted(replace(stage, times=replace(stage.times, apart=1.25))).state
    assert backend.lengths[taken:] == 100 * [2.0] + 100 * [1.0]
    assert (after.step_length, after.steps, after.retaken) == (0.5, begun.state.steps + 200, 100)
    assert begun.schedule.all_steps(after.steps, after.retaken) == begun.schedule.all_steps(after.steps - 100) + 100
    target = after.target.moved(begun.levels.finest.missing(after.gaussians, half=True))
    assert isinstance(target, ExaggeratedTarget)
    assert target.added is not None
    added = np.subtract(target.now, target.original)
    np.testing.assert_array_equal(added, np.broadcast_to(target._enlarged_whole(target.added), added.shape))


def test_the_trace_shows_what_would_be_decoded() -> None:
    """At a coarse quantum rounding costs decibels, which the unrounded Gaussians do not show."""
    begun = asked(CROP, Budget("psnr", 30)).begun()
    for at in RD.effort.times.growth_at[:3]:
        begun = begun.grown(begun.stage(100, at))
    begun = begun.fitted(begun.stage(50))
    recorder = Recorder(Clock())
    begun = replace(begun, recorder=recorder, state=replace(begun.state, quantum=1.0))
    levels, state = begun.levels, begun.fitted(begun.stage(1)).state
    decoded = decode(container.serialise(levels.problem.stream(state.gaussians, 1.0)))
    wanted = float(np.square((decoded - CROP.astype(np.float64)) / 255).mean())
    shown = 10 ** (-recorder.points[-1].psnr / 10)
    assert shown == pytest.approx(wanted, rel=0.01)  # but for 8 bits and what is clamped
    assert recorder.points[-1].psnr == pytest.approx(levels.psnr(state.gaussians, state.quantum), abs=1e-3)
    assert shown > 1.03 * levels.finest.gradients(state.gaussians)[0]


def test_the_size_grows_with_the_gaussians() -> None:
    begun = asked(CROP, BUDGET).begun()
    first, second = (begun.stage(100, at) for at in RD.effort.times.growth_at[:2])
    begun = begun.grown(first).steered(first)
    state, grown = begun.state, begun.grown(second).state
    assert len(grown.gaussians) > len(state.gaussians)
    before = state.size / len(state.gaussians)
    assert grown.size / len(grown.gaussians) == pytest.approx(before, rel=0.05)


def test_a_step_leaves_the_state_that_it_was_given() -> None:
    begun = asked(CROP, BUDGET).begun()
    state = begun.state
    before = state.gaussians.copy(), state.moments.copy()
    after = begun.fitted(begun.stage(3)).state
    assert after.steps == 3
    for was, now, later in zip(before[0].arrays, state.gaussians.arrays, after.gaussians.arrays, strict=True):
        assert np.array_equal(was, now)
        assert not np.array_equal(now, later)
    assert np.array_equal(before[1].bias, state.moments.bias)


def test_a_surplus_that_no_pruning_has_taken_back_is_dropped_at_the_end_of_a_run() -> None:
    """A time limit that ends in the middle of a step may skip the last pruning."""
    begun = asked(CROP, Budget("gaussians", 20)).begun()
    for at in RD.effort.times.growth_at[:4]:
        begun = begun.grown(begun.stage(100, at))
    assert len(begun.state.gaussians) > 20
    pruned = prune_to_limit(begun.levels, begun.rate, begun.state, begun.schedule.times(0))
    assert 15 <= len(pruned.gaussians) <= 20
