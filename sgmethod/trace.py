"""Progress of an encode: error against time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class TracePoint:
    """One point of an encode's trace.

    seconds: since the encode began; step, steps: optimiser steps done and scheduled (convergence or a time limit may
    end the schedule early); psnr: dB over all channels of the picture as it would decode now (unquantised in phase
    "fit"); bytes: estimated file size, 0 while unknown; phase: "joint", then "search" (profile rd), "fit", then "tune"
    (the other), finally "done". A search for the best integers counts its own steps.
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


# When each phase begins and ends, as a part of an encode's time: medians of eight encodes of 0.4 and 9 megapixels.
# Within a phase, time is about proportional to steps.
SHARES = {"joint": (0.04, 0.87), "search": (0.87, 1.0), "fit": (0.0, 0.6), "tune": (0.6, 1.0), "done": (1.0, 1.0)}


def share_of(phase: str, step: int, steps: int) -> float:
    """Estimate the part of an encode's time that is over, 0 to 1, from a point of its trace."""
    begin, end = SHARES.get(phase, (0.0, 0.0))
    return begin + (end - begin) * min(step / max(steps, 1), 1.0)


Progress = Callable[[TracePoint], None]
Stop = Callable[[], bool]
Preview = Callable[[bytes], None]
