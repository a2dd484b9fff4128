"""Search: make several files of a fit and keep the best."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from sgmethod.bitstream.v2 import StreamV2
from sgmethod.rd.plan import Plan, State
from sgmethod.rd.quantise import PayloadLimit, quantised, relaxed
from sgmethod.rd.rate_control import Coded
from sgmethod.scene import Gaussians


def search(plan: Plan, state: State, rounds: int) -> Coded:
    """Code a fit with several quanta, and return the file that meets the budget best.

    rounds: completed. For each after the first, a random half of the Gaussians is fitted again to what rounding the
    others leaves, and all are refined again: refining alone finds no single change that helps.
    """
    request, rate = plan.request, plan.request.rate

    @cache  # several quanta have one code
    def coded(quantum: float) -> StreamV2:
        return request.stream(state.gaussians, quantum)

    def payload(quantum: float) -> int:
        return len(coded(StreamV2.coded_quantum(quantum, rate.is_short)).payload)

    texture = request.objective.texture(coded(state.quantum))
    if texture is not None and not rate.affords(texture):
        texture = None
    empty = replace(request.stream(Gaussians.empty(0), state.quantum), texture=texture)
    limit, target = PayloadLimit(rate.payload_limit(empty), texture), state.target.now

    tried: list[Coded] = []
    quantum: float | None = rate.first_quantum(state.quantum, payload, limit.max_bytes)
    for _ in request.deadline.tries(plan.settings.rate.aim_tries):
        if quantum is None:
            break
        tried.append(quantised(plan, state.gaussians, target, quantum, limit))
        quantum = rate.next_quantum(tried, limit.max_bytes, plan.settings.effort.size_tries)
    if rate.is_cut_short(payload(state.quantum), limit.max_bytes):
        tried.append(quantised(plan, state.gaussians, target, state.quantum, limit))
    best = rate.chosen(tried)
    lot = np.random.default_rng(request.seed)
    for _ in request.deadline.tries(max(rounds - 1, 0) if best.size else 0):
        held = lot.random(len(best.stream.gaussians())) < 0.5
        again = relaxed(plan, best.stream, target, held)
        less = replace(limit, max_bytes=min(limit.max_bytes, rate.relaxed_bytes(best)))
        best = rate.best([best, quantised(plan, again, target, best.stream.quantum, less)])
    if not request.is_nearly_flat:
        return best
    empty = replace(empty, quantum=best.stream.quantum)
    return rate.best([best, Coded(empty, request.objective)])
