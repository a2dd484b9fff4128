"""Who is preferred: the answers of a blind page by the model of Bradley and Terry, with intervals.

An answer "neither" is half a vote for each. Votes of one visitor, and votes on one photograph, are not independent, so
that intervals come from drawing visitors and photographs again, each with replacement. A pair of codecs that was shown
begins with half a vote for each side: the odds of one that nobody doubts stay finite.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.tables import number, table

DRAWS, STEPS = 2000, 300
INTERVAL = (2.5, 97.5)  # percentiles
Float = NDArray[np.float64]


class Vote(NamedTuple):
    """One answer: two codecs, and the share of the vote for the first."""

    visitor: int
    photograph: str
    first: str
    second: str
    share: float


def votes(key: dict[str, Any], answers: Sequence[dict[str, Any]]) -> list[Vote]:
    """Read visitors' answers. Exits with a message for answers to another page."""
    found = []
    for visitor, of_visitor in enumerate(answers):
        for answer in of_visitor["answers"]:
            pair = key["pairs"].get(answer["source"])
            if pair is None:
                raise SystemExit(f"{answer['source']} is not in the key: it is another page's")
            (one, first), (_, second) = pair["versions"].items()
            chosen = answer["chosen"]
            share = 0.5 if chosen not in pair["versions"] else float(chosen == one)
            found.append(Vote(visitor, pair["photograph"], first, second, share))
    return found


def log_odds(wins: Float) -> Float:
    """Strengths [B, K] of K codecs that explain their wins [B, K, K] over each other best, with a mean of 0."""
    games, won = wins + wins.swapaxes(1, 2), wins.sum(2)
    strength = np.ones(won.shape)
    for _ in range(STEPS):  # each raises the likelihood (Hunter, "MM algorithms for generalized Bradley-Terry models")
        met = games / (strength[:, :, None] + strength[:, None, :])
        strength = won / met.sum(2)
        strength /= np.exp(np.log(strength).mean(1, keepdims=True))
    return np.log(strength)


def drawn_wins(every: Sequence[Vote], codecs: Sequence[str], seed: int) -> Float:
    """Wins [1 + DRAWS, K, K]: as they are, and for each draw of visitors and photographs."""
    lot, size = np.random.default_rng(seed), len(codecs)
    weight = np.ones((1 + DRAWS, len(every)))
    for names in ([str(vote.visitor) for vote in every], [vote.photograph for vote in every]):
        kinds, which = np.unique(names, return_inverse=True)
        weight[1:] *= lot.multinomial(len(kinds), np.full(len(kinds), 1 / len(kinds)), DRAWS)[:, which]
    place = {codec: k for k, codec in enumerate(codecs)}
    share, shown = np.zeros((len(every), size, size)), np.zeros((size, size))
    for k, vote in enumerate(every):
        pair = place[vote.first], place[vote.second]
        share[k][pair], share[k][pair[::-1]] = vote.share, 1 - vote.share
        shown[pair] = shown[pair[::-1]] = 0.5
    return np.asarray(np.einsum("bv,vij->bij", weight, share) + shown)


def summary(every: Sequence[Vote], seed: int = 0) -> str:
    """A line for each pair of codecs: the log odds that the first is preferred; below 0 the other one is."""
    codecs = list(dict.fromkeys([*(vote.first for vote in every), *(vote.second for vote in every)]))
    odds, lines = log_odds(drawn_wins(every, codecs, seed)), []
    for one, other in combinations(range(len(codecs)), 2):
        apart = odds[:, one] - odds[:, other]
        low, high = np.percentile(apart[1:], INTERVAL)
        pair = {codecs[one], codecs[other]}
        asked = sum({vote.first, vote.second} == pair for vote in every)
        chance = number(1 / (1 + float(np.exp(-apart[0]))), ".0%")
        ends = f"{number(low, '+.2f')} to {number(high, '+.2f')}"
        lines.append([codecs[one], codecs[other], asked, chance, number(apart[0], "+.2f"), ends])
    visitors, photographs = ({vote[k] for vote in every} for k in (0, 1))
    who = f"visitors: {len(visitors)}, photographs: {len(photographs)}, answers: {len(every)}"
    return f"{table('codec | against | answers | preferred | log odds | 95 % interval', lines)}\n\n{who}"
