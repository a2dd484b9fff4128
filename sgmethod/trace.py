"""Progress of an encode: error against time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class TracePoint:
    """One point of an encode's trace.

    seconds: since the encode began; step, steps: optimiser steps done and scheduled (convergence or a time limit may
    end the schedule early); psnr: dB over all channels of the picture as it would decode now (unquantised in phase
    "fit"); bytes: estimated file size, 0 while unknown; phase: "joint" (profile rd), "fit" or "tune" (the others),
    finally "done".
    """

    seconds: float
    step: int
    steps: int
    psnr: float
    bytes: int
    gaussians: int
    phase: str

    def to_dict(self) -> dict[str, float | int | str]:
        """Return the point as plain JSON types."""
        return asdict(self)


Progress = Callable[[TracePoint], None]
Stop = Callable[[], bool]
Preview = Callable[[bytes], None]
