"""What a fit reports while it runs: error against time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class TracePoint:
    """One line of a fit's trace.

    seconds: since the encode began; step of steps: optimiser steps done and scheduled (the schedule may be cut
    short by convergence or a time limit); psnr: dB over all channels of the picture as it would decode
    then (unquantised in phase "fit"); bytes: estimated size of the file, 0 while unknown;
    phase: "joint" (profile rd), "fit" or "tune" (the others), at last "done".
    """

    seconds: float
    step: int
    steps: int
    psnr: float
    bytes: int
    gaussians: int
    phase: str

    def to_dict(self) -> dict[str, float | int | str]:
        """The point as plain JSON types."""
        return asdict(self)


Progress = Callable[[TracePoint], None]
Stop = Callable[[], bool]
Preview = Callable[[bytes], None]


def shown_to_nobody(_: bytes) -> None:
    """A preview that nobody asked for."""
