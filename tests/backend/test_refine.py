"""Refining on each backend: it lowers the cost, about as far as the other one does, and keeps to its limits."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import NO_LIMIT, TARGET_WHITE, Backend, Coding, Frame, RefineLimits, Target, Visibility
from sgmethod.bitstream.v2 import StreamV2
from sgmethod.scene import Gaussians
from tests.backend.cases import SIZE, VISIBILITIES, scattered, visibility
from tests.definitions.backend import Reference

REFERENCE = Reference()
BACKENDS: tuple[Backend, ...] = Kernels(), REFERENCE
CODING = Coding(*SIZE, 0.3)
FRAME = Frame(*SIZE)

each_backend = pytest.mark.parametrize("backend", BACKENDS, ids=["kernels", "reference"])


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


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("price", [0.0, 1e-3])
@pytest.mark.parametrize("kind", [kind for kind in VISIBILITIES if kind != "coarse"])
def test_each_sweep_lowers_the_cost(kind: str, price: float, seed: int) -> None:
    gaussians, target = scene(seed)
    seen, ends = visibility(kind, seed), []
    for backend in BACKENDS:
        payloads = [
            backend.refine(gaussians, CODING, target, RefineLimits(price, sweeps, math.inf, NO_LIMIT), seen)
            for sweeps in (0, 1, 2)
        ]
        costs = [cost(payload, target, price, seen) for payload in payloads]
        assert all(after < before for before, after in pairwise(costs))
        ends.append((costs[0], costs[-1]))
    (start, of_kernels), (also, of_reference) = ends
    assert start == also  # both begin with rounding
    assert 0.8 < (start - of_kernels) / (start - of_reference) < 1.3  # seen: 0.89 to 1.24


@each_backend
@pytest.mark.parametrize("share", [0.95, 0.5, 0.0])
def test_the_limit_is_kept_by_leaving_out_what_matters_least(share: float, backend: Backend) -> None:
    gaussians, target = scene(0)
    rounding = RefineLimits(0.0, 0, math.inf, NO_LIMIT)
    limit = int(share * len(backend.refine(gaussians, CODING, target, rounding, None)))
    cut = backend.refine(gaussians, CODING, target, RefineLimits(0.0, 1, math.inf, limit), None)
    assert limit - 16 < len(cut) <= limit
    if share == 0.5:  # better than any half that was chosen without looking
        for seed in range(5):
            half = gaussians.rows(np.random.default_rng(seed).permutation(25)[:12])
            some = backend.refine(half, CODING, target, rounding, None)
            assert cost(cut, target, 0.0, None) < cost(some, target, 0.0, None)


@each_backend
def test_no_sweep_begins_after_the_end_of_the_time(backend: Backend) -> None:
    gaussians, target = scene(0)
    found = [
        backend.refine(gaussians, CODING, target, RefineLimits(0.0, *limits, NO_LIMIT), None)
        for limits in ((0, math.inf), (5, 0.0))
    ]
    assert found[0] == found[1]


@each_backend
@pytest.mark.parametrize(("grey", "upright"), [(True, False), (False, True), (True, True)])
def test_what_does_not_fit_into_the_file_stays_out(grey: bool, upright: bool, backend: Backend) -> None:
    gaussians, target = scene(1)
    coding = Coding(*SIZE, 0.3, grey, upright)
    found = decoded(backend.refine(gaussians, coding, target, RefineLimits(0.0, 1, math.inf, NO_LIMIT), None), coding)
    assert not upright or not found.factors[:, 1].any()
    assert not grey or np.ptp(found.colors, axis=1).max() < 1e-6
