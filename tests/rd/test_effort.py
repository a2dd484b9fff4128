"""Effort: more time makes a file that is no worse, and a time limit or a stop ends the search with the best so far."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from sgmethod import Budget, BudgetError, Encoded, codec, decode, encode
from sgmethod.bitstream import container
from sgmethod.fitting.parameters import Parameters
from sgmethod.fitting.recorder import Clock, Recorder
from sgmethod.fitting.request import Request
from sgmethod.io.image import read_image_8_bit
from sgmethod.profiles import DEFAULT_EFFORT, RD, Tune
from sgmethod.rd.finish import Finish
from sgmethod.rd.fit import RdFit, relaxed
from sgmethod.rd.rate_control import RateControl
from sgmethod.rd.runs import Runs, place
from sgmethod.trace import shown_to_nobody
from tests.harness.data import PHOTOGRAPHS

BUDGETS = (
    Budget("bytes", 600),
    Budget("psnr", 25),
    Budget("psnr", 60),  # which none reaches, and which takes long
    Budget("quality", 50),
    Budget("gaussians", 40),
)


@cache
def crop() -> NDArray[np.uint8]:
    """A parrot's eye, 48 x 40."""
    pixels = read_image_8_bit((PHOTOGRAPHS / "kodim23-crop.png").read_bytes())
    return np.ascontiguousarray(pixels[24:64, 40:88])


def requested(budget: Budget, tune: Tune) -> Request:
    return Request(crop(), budget, "rd", tune, 5, 0, Recorder(Clock(), None))


@cache
def fitted(budget: Budget, tune: Tune) -> RdFit:
    """Gaussians as an encode of the default effort has them before they are rounded."""
    request = requested(budget, tune)
    settings = replace(RD, tune=tune)
    runs = Runs(place(request, RateControl.of(request, settings), shown_to_nobody), request, 1000)
    with torch.no_grad():
        runs.first()
        runs.until_round(1)
    return runs.fit


def flat() -> NDArray[np.uint8]:
    return np.full((40, 48, 3), (200, 40, 90), np.uint8)


@cache
def encoded(kind: str, value: float, effort: int, tune: str = "psnr") -> Encoded:
    return encode(crop(), Budget(kind, value), tune=tune, effort=effort)  # type: ignore[arg-type]


def assert_no_worse(more: Encoded, less: Encoded, budget: Budget) -> None:
    """By what the budget leaves open."""
    if budget.kind in ("bytes", "gaussians"):
        assert more.stats.psnr >= less.stats.psnr - 1e-9
    elif less.stats.psnr >= budget.value:
        assert more.stats.psnr >= budget.value
        assert len(more.data) <= len(less.data)
    elif budget.kind == "psnr":
        assert more.stats.psnr >= less.stats.psnr - 1e-9


@pytest.mark.parametrize("budget", BUDGETS, ids=lambda budget: f"{budget.kind}-{budget.value:g}")
def test_more_effort_is_never_worse(budget: Budget) -> None:
    efforts = range(DEFAULT_EFFORT, 7 if budget == Budget("psnr", 60) else 9)
    found = [encoded(budget.kind, budget.value, effort) for effort in efforts]
    for less, more in pairwise(found):
        assert_no_worse(more, less, budget)
        assert more.stats.steps >= less.stats.steps
        assert (more.stats.effort, less.stats.effort) == (less.stats.effort + 1, less.stats.effort)
    limit = budget.max_bytes(48, 40)
    assert limit is None or max(len(one.data) for one in found) <= limit
    if budget.kind == "gaussians":
        assert max(one.stats.gaussians for one in found) <= budget.value


@pytest.mark.parametrize("size", [150, 600])
def test_more_effort_is_never_worse_on_the_ladder(size: int) -> None:
    """Which lower efforts climb from what they have found alone."""
    pixels = read_image_8_bit((PHOTOGRAPHS / "kodim23-crop.png").read_bytes())
    grey = np.repeat(np.ascontiguousarray(pixels[:72, :28, 1:2]), 3, axis=2)
    found = [encode(grey, Budget("bytes", size), tune="psnr", effort=effort) for effort in (5, 6, 7)]
    for less, more in pairwise(found):
        assert_no_worse(more, less, Budget("bytes", size))
    assert max(len(one.data) for one in found) <= size
    assert found[0].stats.steps > 1000  # of the ladder


def test_most_effort_gains() -> None:
    most, usual = (encoded("gaussians", 40, effort).stats for effort in (9, 5))
    assert most.psnr > usual.psnr + 0.1
    assert most.steps > 5 * usual.steps


@pytest.mark.parametrize("tune", ["psnr", "visual"])
def test_gaussians_that_are_held_stay(tune: Tune) -> None:
    """And the others take over what rounding has left."""
    fit = fitted(Budget("bytes", 600), tune)
    rounded = Parameters.of(fit.coder.stream(fit.p).gaussians())
    held = np.arange(len(rounded.means)) % 2 == 0
    moved = relaxed(fit.picture, rounded, held, fit.coder.quantum, fit.settings)
    for before, after in zip(rounded.arrays(), moved.arrays(), strict=True):
        assert (before[held] == after[held]).all()
        assert (before[~held] != after[~held]).any(1).mean() > 0.9
    assert fit.picture.gradients(moved)[0] < 0.97 * fit.picture.gradients(rounded)[0]


@pytest.mark.parametrize("budget", BUDGETS, ids=lambda budget: f"{budget.kind}-{budget.value:g}")
def test_relaxing_makes_a_better_file(budget: Budget) -> None:
    fit, request = fitted(budget, "psnr"), requested(budget, "psnr")
    refined, again, once_more = (Finish(fit, request, relaxings).found() for relaxings in (0, 8, 8))
    assert again.stream == once_more.stream
    size, less = len(again.stream.payload), len(refined.stream.payload)
    gained = refined.finish.psnr(again.stream) - refined.finish.psnr(refined.stream)
    if budget.kind == "psnr":
        # At 60 dB each Gaussian is worth decibels: none can go.
        assert size < 0.99 * less if budget.value == 25 else size <= less
        assert refined.finish.psnr(again.stream) >= budget.value
    elif budget.kind == "quality":
        assert gained > 0 or size < less
        assert refined.finish.best([refined, again]) is again
    else:
        assert gained > 0.02
        assert budget.kind != "bytes" or len(container.serialise(again.stream)) <= 600


def test_little_effort_takes_few_steps_and_keeps_the_budget() -> None:
    found = [encoded("bytes", 600, effort) for effort in range(1, DEFAULT_EFFORT + 1)]
    steps = [one.stats.steps for one in found]
    assert steps == sorted(set(steps))
    assert steps[0] <= steps[-1] / 3
    assert all(len(one.data) <= 600 for one in found)
    assert found[0].stats.psnr > found[-1].stats.psnr - 3
    assert decode(found[0].data).shape == crop().shape


def test_the_eye_is_served_by_effort_too() -> None:
    usual, more = (encoded("bytes", 600, effort, "visual") for effort in (5, 7))
    assert more.stats.tune == "visual"
    assert len(more.data) <= 600
    assert more.data != usual.data


def test_a_time_limit_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    class SlowClock(Clock):
        """Each look at it takes a hundredth of a second."""

        now = 0.0

        def seconds(self) -> float:
            self.now += 0.01
            return self.now

    monkeypatch.setattr(codec, "Clock", SlowClock)
    limited = encode(crop(), Budget("bytes", 600), tune="psnr", effort=9, time_limit_s=40.0)
    usual = encoded("bytes", 600, 5).stats.steps
    assert 1.5 * usual < limited.stats.steps < 6 * usual  # of 12 times as many
    assert limited.stats.seconds < 40.2
    assert len(limited.data) <= 600
    assert limited.stats.psnr > encoded("bytes", 600, 5).stats.psnr


def test_a_stop_ends_the_search_with_what_there_is() -> None:
    steps: list[int] = []
    stopped = encode(
        crop(),
        Budget("bytes", 600),
        tune="psnr",
        effort=9,
        on_progress=lambda point: steps.append(point.step),
        stop=lambda: max(steps, default=0) >= 800,
    )
    assert 800 <= stopped.stats.steps < 3 * encoded("bytes", 600, 5).stats.steps
    assert len(stopped.data) <= 600
    assert stopped.stats.psnr >= encoded("bytes", 600, 5).stats.psnr


def test_the_trace_counts_all_steps() -> None:
    points = [point for point in encoded("bytes", 600, 7).trace if point.phase == "joint"]
    assert {point.steps for point in points} == {points[-1].steps}
    assert [point.step for point in points] == sorted(point.step for point in points)
    assert points[-1].step == points[-1].steps == encoded("bytes", 600, 7).stats.steps


def test_a_picture_of_one_colour_takes_no_search() -> None:
    least, most = (encode(flat(), Budget("bytes", 600), effort=effort) for effort in (1, 9))
    assert len(least.data) == len(most.data)
    assert (decode(most.data) == flat()).all()
    assert most.stats.steps < 400


@pytest.mark.parametrize("effort", [0, 10, -1, 5.5, 5.0, True, "5", None, [5]])
def test_an_effort_that_is_none_is_refused(effort: object) -> None:
    with pytest.raises(BudgetError, match="effort must be one of 1 to 9"):
        encode(crop(), effort=effort)  # type: ignore[arg-type]


def test_other_profiles_have_no_effort() -> None:
    with pytest.raises(BudgetError, match="an effort goes with profile rd alone"):
        encode(crop(), Budget("bytes", 600), "paper", effort=6)
