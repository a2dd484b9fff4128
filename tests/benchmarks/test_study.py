"""The blind page's order of letters, and what its answers say, where it can be known beforehand."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest

from benchmarks.perceptual.blind import OURS, THEIRS, in_twos
from benchmarks.perceptual.study import Vote, log_odds, summary, votes

PAIRS = [*product(OURS, THEIRS)] * 6


def answered(visitors: int, chance: float) -> str:
    """The summary for visitors who prefer ours with some chance, whatever they see."""
    lot = np.random.default_rng(5)
    every = [
        Vote(visitor, f"p{k}", *pair, float(lot.random() < chance))
        for visitor in range(visitors)
        for k, pair in enumerate(PAIRS)
    ]
    return summary(every)


@pytest.mark.parametrize(("chance", "sign"), [(0.5, 0), (0.8, 1), (0.2, -1)])
def test_intervals_hold_what_visitors_do(chance: float, sign: int) -> None:
    """Answers made by chance: every interval holds 0. A preference: none of ours against theirs does."""
    lines = [line.split(" | ") for line in answered(20, chance).splitlines()[2:8]]
    assert len(lines) == 6
    for one, other, *_, interval in lines:
        low, high = (float(word) for word in interval.removesuffix(" |").split(" to "))
        if sign != 0 and one.strip("| ") in OURS and other in THEIRS:
            assert min(sign * low, sign * high) > 0
        else:
            assert low < 0 < high


def test_log_odds_by_hand() -> None:
    """3 to 1 between a and b, and 2 to 1 between b and c, who never met a."""
    wins = np.array([[[0, 3, 0], [1, 0, 2], [0, 1, 0]]], float)
    a, b, c = log_odds(wins)[0]
    assert (a - b, b - c) == (pytest.approx(math.log(3)), pytest.approx(math.log(2)))


def test_answers_are_read_by_the_key() -> None:
    key = {"pairs": {"s": {"photograph": "p", "versions": {"o": "ours", "a": "avif"}}}}
    answers = [{"answers": [{"source": "s", "chosen": chosen}]} for chosen in ("o", "a", "neither")]
    assert [vote.share for vote in votes(key, answers)] == [1, 0, 0.5]
    with pytest.raises(SystemExit, match="another page"):
        votes(key, [{"answers": [{"source": "t", "chosen": "o"}]}])


def test_ours_is_on_the_left_in_half_of_the_pairs_however_they_are_turned() -> None:
    """Each two neighbours are turned together, and have ours on opposite sides."""
    listed = in_twos([[f"s{k}", "ours", "avif"] for k in range(24)], np.random.default_rng(0))
    assert [source for source, *_ in listed] == [f"s{k}" for k in range(24)]
    sides = ["".join(pair[1][0] for pair in listed[k : k + 2]) for k in range(0, 24, 2)]
    assert {*sides} == {"oa", "ao"}  # in some the first, in others the second
