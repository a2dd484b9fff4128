"""encode() by profile paper: what tests/test_codec.py does not try of every profile."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import pytest
import torch

from sgmethod import Budget, Encoded, TracePoint
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


def test_a_limit_too_short_for_anything_still_gives_a_file() -> None:
    for budget in (Budget("bytes", 400), Budget("psnr", 30)):
        encoded = encode(SMALL, budget, time_limit_s=1e-6)
        codec.assert_true_figures(encoded, SMALL)
        assert encoded.stats.steps <= 8


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
