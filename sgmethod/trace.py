"""Progress of an encode: error against time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class TracePoint:
    """One point of an encode's trace.

    seconds: since the encode began; step, steps: optimiser steps done and scheduled (an exact picture or a time limit
    may end the schedule early); psnr: dB over all channels of the picture as it would decode now (unquantised in phase
    "fit"); bytes: estimated file size, 0 while unknown; phase: "joint", then "search" (profile rd), "fit", then "tune"
    (the other), finally "done". A search for the best integers counts its own steps; share: estimated part of the
    encode's time that is over, 0 to 1.
    """

    seconds: float
    step: int
    steps: int
    psnr: float
    bytes: int
    gaussians: int
    phase: str
    share: float

    def to_dict(self) -> dict[str, float | int | str]:
        """Return the point as plain JSON types."""
        return asdict(self)


# Parts of an encode's time, chosen on 14 encodes of 0.04 to 9 megapixels. The first steps are the fastest: their
# Gaussians are few, and are fitted to a reduced picture.
BEGIN = 0.05  # of the first step
A_TRY = 0.06  # to find the best integers for a quantum
PHASES = {"fit": (BEGIN, 0.38), "tune": (0.38, 1.0), "done": (1.0, 1.0)}
JOINT_STEPS, JOINT_SHARE = (0.0, 0.25, 0.5, 0.75, 1.0), (0.0, 0.12, 0.31, 0.64, 1.0)
MIN_SHARE_FOR_ETA = 0.1  # of the time; an estimate before that is far off


def share_of(phase: str, step: int, steps: int, tries: int = 1) -> float:
    """Estimate the part of an encode's time that is over, 0 to 1, from the step of a phase and the usual tries."""
    done, search = min(step / max(steps, 1), 1.0), 1 - A_TRY * tries
    if phase == "joint":
        return BEGIN + (search - BEGIN) * float(np.interp(done, JOINT_STEPS, JOINT_SHARE))
    begin, end = (search, 1.0) if phase == "search" else PHASES.get(phase, (0.0, 0.0))
    return begin + (end - begin) * done


def seconds_left(trace: Sequence[Mapping[str, Any]], seconds: float, limit_s: float = math.inf) -> float | None:
    """Estimate the seconds that an encode still takes; None if its trace is too short, or at its end.

    trace: points as TracePoint.to_dict() returns them; seconds: since the encode began.
    """
    if not trace:
        return None
    (began, begin), (at, share) = ((point["seconds"], point.get("share", 0.0)) for point in (trace[0], trace[-1]))
    if not begin + MIN_SHARE_FOR_ETA <= share < 1:
        return None
    end = at + (at - began) / (share - begin) * (1 - share)
    return float(max(min(end, limit_s) - seconds, 0.0))


Progress = Callable[[TracePoint], None]
