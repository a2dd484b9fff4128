"""encode() by profile paper: what tests/test_codec.py does not try of every profile."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch

from sgmethod import Budget, BudgetError, Encoded, TracePoint
from sgmethod.paper import encode as paper
from tests import test_codec as codec
from tests.rd.short import SlowClock
from tests.support.pictures import noise
from tests.test_codec import SMALL


def encode(image: Any, budget: Budget | None = None, **named: Any) -> Encoded:
    return codec.encode(image, budget, "paper", **named)


def test_a_number_of_gaussians_is_met() -> None:
    """Profile rd adds one only where it pays (tests/rd/test_rd.py)."""
    for n in (1, 2, 50):
        encoded = encode(SMALL, Budget("gaussians", n))
        codec.assert_true_figures(encoded, SMALL)
        assert encoded.stats.gaussians == n


def test_as_many_gaussians_as_pixels() -> None:
    pixels = noise(5, 7)
    assert encode(pixels, Budget("gaussians", 35)).stats.gaussians == 35
    encoded = encode(pixels, Budget("bytes", 100_000))
    codec.assert_true_figures(encoded, pixels)
    assert encoded.stats.gaussians <= 35


def test_a_picture_too_small_for_the_usual_budget_gets_one_gaussian() -> None:
    assert encode(SMALL[:20, :30]).stats.gaussians == 1


def test_a_quality_out_of_reach_gives_the_best_found() -> None:
    pixels = noise(12, 16)
    encoded = encode(pixels, Budget("psnr", 60))
    codec.assert_true_figures(encoded, pixels)
    assert encoded.stats.psnr < 60
    ends = [a.psnr for a, b in pairwise(encoded.trace) if a.phase == "tune" and b.phase != "tune"]
    assert len(ends) > 1
    assert encoded.stats.psnr > max(ends) - 0.5


@pytest.fixture
def clocks(monkeypatch: pytest.MonkeyPatch) -> list[SlowClock]:
    made: list[SlowClock] = []

    def make() -> SlowClock:
        made.append(SlowClock())
        return made[-1]

    monkeypatch.setattr("sgmethod.codec.Clock", make)
    return made


@pytest.mark.parametrize("budget", [Budget("bytes", 400), Budget("psnr", 60)])
def test_a_time_limit_ends_the_encode_with_what_there_is(budget: Budget, clocks: list[SlowClock]) -> None:
    encoded = encode(SMALL, budget, time_limit_s=2.0)
    assert clocks[-1].now < 2.2
    codec.assert_true_figures(encoded, SMALL)
    assert 10 < encoded.stats.steps < 100
    assert {p.phase for p in encoded.trace} == {"fit", "tune", "done"}


def asked_time(budget: Budget, limit_s: float) -> float:
    """The time that the refusal of a limit asks for."""
    with pytest.raises(BudgetError, match=r"the time limit is too short: profile paper took .* to start") as refused:
        encode(SMALL, budget, time_limit_s=limit_s)
    named = re.search(r"at least ([0-9.]+) s$", str(refused.value))
    assert named
    return float(named[1])


@pytest.mark.parametrize("budget", [Budget("bytes", 400), Budget("psnr", 30)])
def test_a_limit_too_short_to_fit_anything_is_refused(budget: Budget, clocks: list[SlowClock]) -> None:
    """It gave files of 10 dB: to load PyTorch and to start counts, and may take all of it."""
    assert asked_time(budget, 1e-6) > 0
    assert clocks[-1].now < 0.1  # it is refused before it starts
    encoded = encode(SMALL, budget, time_limit_s=asked_time(budget, 0.3))
    codec.assert_true_figures(encoded, SMALL)
    assert encoded.stats.steps >= paper.USABLE_STEPS or encoded.stats.psnr >= paper.USABLE_DB


@pytest.mark.usefixtures("clocks")
def test_a_flat_picture_needs_hardly_any_time() -> None:
    encoded = encode(np.zeros((40, 56), np.uint8), Budget("gaussians", 20), time_limit_s=0.3)
    assert encoded.stats.psnr >= paper.USABLE_DB


def test_the_file_does_not_depend_on_threads(set_threads: Callable[[int], None]) -> None:
    """Nor does that of profile rd (tests/rd/test_reproducible.py)."""
    files = []
    for threads in (1, 3):
        set_threads(threads)
        files.append(encode(SMALL, Budget("bytes", 400)).data)
    assert files[0] == files[1]


@pytest.fixture
def torch_threads() -> Iterator[int]:
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    yield 3
    torch.set_num_threads(before)


@pytest.mark.parametrize("phase", ["fit", "tune", "done"])
def test_an_encode_can_be_abandoned(phase: str, torch_threads: int) -> None:
    def abandon(point: TracePoint) -> None:
        if point.phase == phase:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        encode(SMALL, Budget("bytes", 400), on_progress=abandon)
    assert torch.get_num_threads() == torch_threads
    assert torch.is_grad_enabled()
    fresh = encode(SMALL, Budget("bytes", 400)).data
    assert fresh == encode(SMALL, Budget("bytes", 400)).data
    assert torch.get_num_threads() == torch_threads
