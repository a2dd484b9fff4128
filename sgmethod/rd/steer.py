"""Steer: the quantum follows the budget."""

from __future__ import annotations

from dataclasses import replace

from sgmethod.bitstream import container
from sgmethod.bitstream.payload import HEADER_BYTES, quantum_code, quantum_of
from sgmethod.rd.quantise import exact_psnr, rounded_psnr
from sgmethod.rd.request import Plan, Stage, State
from sgmethod.trace import shown_to_nobody


def steer(plan: Plan, state: State, stage: Stage) -> State:
    """The state with the file's size, and with the quantum that rate control wants for it."""
    request = plan.request
    stream = request.stream(state.gaussians, state.quantum)
    size = HEADER_BYTES + len(stream.payload)
    if request.recorder.preview is not shown_to_nobody:
        request.recorder.preview(container.serialise(stream))
    psnrs = (lambda: rounded_psnr(plan, state)), (lambda: exact_psnr(plan, state.gaussians))
    quantum = request.rate.steered(state.quantum, stage.times, stage.at, size, *psnrs)
    return replace(state, size=size, quantum=quantum_of(quantum_code(quantum)))
