"""Steer: the quantum follows the budget."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

from sgmethod.bitstream import container
from sgmethod.bitstream.v2 import StreamV2
from sgmethod.decoder import draw_whole
from sgmethod.rd.quantise import exact_psnr, rounded_psnr
from sgmethod.rd.rate_control import Coded, looks_db
from sgmethod.rd.request import Plan, Stage, State
from sgmethod.trace import shown_to_nobody


def steer(plan: Plan, state: State, stage: Stage) -> State:
    """The state with the file's size, and with the quantum that rate control wants for it."""
    request = plan.request
    stream = request.stream(state.gaussians, state.quantum)
    size = stream.file_bytes
    if request.recorder.preview is not shown_to_nobody:
        request.recorder.preview(container.serialise(stream))

    @cache  # a whole picture is drawn for it
    def rounded() -> float:
        return rounded_psnr(plan, state)

    def reached() -> float:
        return looks_db(request.objective.looks(draw_whole(stream))) if request.rate.by_looks else rounded()

    def lost() -> float:
        return exact_psnr(plan, state.gaussians) - rounded()

    quantum = request.rate.steered(state.quantum, stage.times, stage.at, size, reached, lost)
    return replace(state, size=size, quantum=StreamV2.coded_quantum(quantum, request.rate.is_short))


def once_more(plan: Plan, state: State, files: Iterable[Coded]) -> State:
    """The state for a further round, where files miss what was asked for.

    Looks count grain, and a file that aims at them has no texture in its place: growth is shown what was hidden, at a
    quantum that is finer by as much as is missing.
    """
    rate = plan.request.rate
    if not rate.by_looks:
        return state
    quantum = rate.finer(state.quantum, max(map(rate.reached, files)))
    return replace(state, target=state.target.whole(), quantum=quantum)
