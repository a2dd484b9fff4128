"""Search: the one loop that makes several files of a fit and keeps the best."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sgmethod.rd.quantise import Room, quantised, relaxed
from sgmethod.rd.rate_control import Coded, Selection
from sgmethod.rd.request import Plan, State
from sgmethod.scene import Gaussians


def search(plan: Plan, state: State, rounds: int) -> Coded:
    """The coded picture that meets the budget best, of those with several quanta.

    rounds: that went before. Once for each but the first, half of the Gaussians, drawn by lot, move to what rounding
    the others has left, and all are refined again: refining alone finds no single change that helps.
    """
    request, selection = plan.request, Selection(plan.request.rate)
    texture = request.objective.texture(request.stream(state.gaussians, state.quantum))
    if texture is not None and (request.rate.by_looks or not selection.affords(texture)):
        texture = None
    empty = replace(request.stream(Gaussians.empty(0), state.quantum), texture=texture)
    limit, target = selection.payload_limit(empty), state.target.now
    room = Room(limit, texture)

    def payload(quantum: float) -> int:
        return len(request.stream(state.gaussians, quantum).payload)

    tried: list[Coded] = []
    quantum: float | None = selection.first_quantum(state.quantum, payload, limit)
    for _ in request.deadline.tries(plan.settings.rate.aim_tries):
        if quantum is None:
            break
        tried.append(quantised(plan, state.gaussians, target, quantum, room))
        quantum = selection.next_quantum(tried, limit, plan.settings.effort.size_tries)
    if selection.is_cut_short(payload(state.quantum), limit):
        tried.append(quantised(plan, state.gaussians, target, state.quantum, room))
    best = selection.best(tried, selection.reachable(tried))
    lot = np.random.default_rng(request.seed)
    for _ in request.deadline.tries(max(rounds - 1, 0) if best.size else 0):
        held = lot.random(len(best.stream.gaussians())) < 0.5
        again = relaxed(plan, best.stream, target, held)
        less = replace(room, max_bytes=min(limit, selection.spared(best)))
        best = selection.best([best, quantised(plan, again, target, best.stream.quantum, less)])
    if not request.is_nearly_flat:
        return best
    empty = replace(empty, quantum=best.stream.quantum)
    return selection.best([best, Coded(empty, request.objective)])
