"""Refining lowers the cost, as the reference measures it, and keeps to its limits."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import NO_LIMIT, TARGET_WHITE, Coding, Frame, RefineLimits, Target, Visibility
from sgmethod.bitstream.v2 import StreamV2
from sgmethod.scene import Gaussians
from tests.backend.cases import SIZE, VISIBILITIES, scattered, visibility
from tests.definitions.backend import Reference

KERNELS, REFERENCE = Kernels(), Reference()
CODING = Coding(*SIZE, 0.3)
FRAME = Frame(*SIZE)


def scene(seed: int) -> tuple[Gaussians, Target]:
    """Gaussians, and a target that they meet but for some noise."""
    gaussians, noise = scattered(25, seed), np.random.default_rng(seed).normal(0, 0.005, (3, *SIZE[::-1]))
    drawn = -REFERENCE.residual(gaussians, FRAME, np.zeros((3, *SIZE[::-1]), np.int16))
    return gaussians, np.round((drawn + noise) * TARGET_WHITE).astype(np.int16)


def decoded(payload: bytes, coding: Coding = CODING) -> Gaussians:
    """What a file of this payload says."""
    return StreamV2(*SIZE, coding.quantum, (0, 0, 0), coding.grey, coding.upright, payload).gaussians()


def cost(payload: bytes, target: Target, price: float, seen: Visibility | None) -> float:
    """Squared error plus price times bits."""
    error = REFERENCE.error(decoded(payload), FRAME, target, seen) if payload else math.nan
    return target.size * error + price * 8 * len(payload)


@pytest.mark.parametrize(("price", "seed", "left"), [(0.0, 0, 0.55), (0.0, 1, 0.7), (1e-3, 0, 0.78), (1e-3, 1, 0.85)])
@pytest.mark.parametrize("kind", [kind for kind in VISIBILITIES if kind != "coarse"])
def test_each_sweep_lowers_the_cost(kind: str, price: float, seed: int, left: float) -> None:
    gaussians, target = scene(seed)
    seen = visibility(kind, seed)
    payloads = [
        KERNELS.refine(gaussians, CODING, target, RefineLimits(price, sweeps, math.inf, NO_LIMIT), seen)
        for sweeps in (0, 1, 2)
    ]
    costs = [cost(payload, target, price, seen) for payload in payloads]
    assert all(after < before for before, after in pairwise(costs))
    assert costs[-1] < left * costs[0]  # seen: 0.52, 0.68, 0.75 and 0.82 at most


@pytest.mark.parametrize("share", [0.95, 0.5, 0.0])
def test_the_limit_is_kept_by_leaving_out_what_matters_least(share: float) -> None:
    gaussians, target = scene(0)
    rounding = RefineLimits(0.0, 0, math.inf, NO_LIMIT)
    limit = int(share * len(KERNELS.refine(gaussians, CODING, target, rounding, None)))
    cut = KERNELS.refine(gaussians, CODING, target, RefineLimits(0.0, 1, math.inf, limit), None)
    assert limit - 16 < len(cut) <= limit
    if share == 0.5:  # better than any half that was chosen without looking
        for seed in range(5):
            half = gaussians.rows(np.random.default_rng(seed).permutation(25)[:12])
            some = KERNELS.refine(half, CODING, target, rounding, None)
            assert cost(cut, target, 0.0, None) < cost(some, target, 0.0, None)


def test_no_sweep_begins_after_the_end_of_the_time() -> None:
    gaussians, target = scene(0)
    found = [
        KERNELS.refine(gaussians, CODING, target, RefineLimits(0.0, *limits, NO_LIMIT), None)
        for limits in ((0, math.inf), (5, 0.0))
    ]
    assert found[0] == found[1]


@pytest.mark.parametrize(("grey", "upright"), [(True, False), (False, True), (True, True)])
def test_what_does_not_fit_into_the_file_stays_out(grey: bool, upright: bool) -> None:
    gaussians, target = scene(1)
    coding = Coding(*SIZE, 0.3, grey, upright)
    found = decoded(KERNELS.refine(gaussians, coding, target, RefineLimits(0.0, 1, math.inf, NO_LIMIT), None), coding)
    assert not upright or not found.factors[:, 1].any()
    assert not grey or np.ptp(found.colors, axis=1).max() < 1e-6
