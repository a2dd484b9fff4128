"""Steer: move the quantum to the budget."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from sgmethod.bitstream.v2 import MIN_QUANTUM, StreamV2
from sgmethod.rd.plan import Plan, Stage, State
from sgmethod.rd.rate_control import Coded


@dataclass(frozen=True)
class FitSnapshot:
    """A fit as it would be coded now. Each quality is measured when it is first asked for."""

    plan: Plan
    state: State
    stream: StreamV2

    @property
    def file_bytes(self) -> int:
        """Size of the file."""
        return self.stream.file_bytes

    @cached_property
    def psnr(self) -> float:
        """PSNR in dB."""
        return self.plan.psnr(self.state.gaussians, self.state.quantum)

    @cached_property
    def ssimulacra2_db(self) -> float:
        """SSIMULACRA 2, as rate_control.ssimulacra2_db() counts it."""
        return Coded(self.stream, self.plan.problem.objective).ssimulacra2_db

    @property
    def lost_db(self) -> float:
        """PSNR that rounding takes, in dB."""
        return self.plan.psnr(self.state.gaussians) - self.psnr


def steer(plan: Plan, state: State, stage: Stage) -> State:
    """Set the file's size, and the quantum that rate control wants for it.

    Where bytes are left at the finest quantum, the picture may be exact already.
    """
    problem, rate = plan.problem, plan.rate
    stream = plan.session.deadline.coded(lambda: problem.stream(state.gaussians, state.quantum))
    now = FitSnapshot(plan, state, stream)
    if stream.quantum <= MIN_QUANTUM and rate.is_enough(Coded(stream, problem.objective)):
        return replace(state, size=now.file_bytes, is_enough=True)
    quantum = rate.steered(state.quantum, stage.times, stage.at, now)
    coded = StreamV2.coded_quantum(quantum, problem.is_short)
    return replace(state, size=now.file_bytes, quantum=coded)
