"""Steer: move the quantum to the budget, by the file as it would be now."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial

from sgmethod.bitstream.v2 import MIN_QUANTUM, StreamV2
from sgmethod.fitting.recorder import Recorder
from sgmethod.rd.levels import Levels
from sgmethod.rd.rate_control import Coded, RateControl
from sgmethod.rd.schedule import Schedule
from sgmethod.rd.state import Stage, State


@dataclass(frozen=True)
class FitSnapshot:
    """A fit as it would be coded now. Each quality is measured when it is first asked for."""

    levels: Levels
    state: State
    stream: StreamV2

    @property
    def file_bytes(self) -> int:
        """Size of the file."""
        return self.stream.file_bytes

    @cached_property
    def psnr(self) -> float:
        """PSNR in dB."""
        return self.levels.psnr(self.state.gaussians, self.state.quantum)

    @cached_property
    def ssimulacra2_db(self) -> float:
        """SSIMULACRA 2, as rate_control.ssimulacra2_db() counts it."""
        return Coded(self.stream, self.levels.problem.objective).ssimulacra2_db

    @property
    def lost_db(self) -> float:
        """PSNR that rounding takes, in dB."""
        return self.levels.psnr(self.state.gaussians) - self.psnr


@dataclass(frozen=True)
class Steering:
    """The guide of a fit that becomes a file: it knows the loop's levels and budget, and also the clock."""

    levels: Levels
    rate: RateControl
    schedule: Schedule
    recorder: Recorder

    def steer(self, state: State, stage: Stage) -> State:
        """Set the file's size, and the quantum that rate control wants for it.

        Where bytes are left at the finest quantum, the picture may be exact already.
        """
        problem = self.levels.problem
        stream = self.schedule.deadline.coded(lambda: problem.stream(state.gaussians, state.quantum))
        now = FitSnapshot(self.levels, state, stream)
        if stream.quantum <= MIN_QUANTUM and self.rate.is_enough(Coded(stream, problem.objective)):
            return replace(state, size=now.file_bytes, is_enough=True)
        quantum = self.rate.steered(state.quantum, stage.times, stage.at, now)
        coded = StreamV2.coded_quantum(quantum, problem.is_short)
        return replace(state, size=now.file_bytes, quantum=coded)

    def report(self, state: State) -> None:
        """Report the progress of the fit."""
        error = partial(self.levels.error, state.gaussians, state.quantum)
        all_steps = self.schedule.all_steps(state.steps, state.retaken)
        self.recorder.report("joint", state.steps, all_steps, error, len(state.gaussians), state.size)
