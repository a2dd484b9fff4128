"""One encode as it was asked for."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sgmethod.budget import Budget
from sgmethod.errors import BudgetError
from sgmethod.fitting.recorder import Recorder
from sgmethod.native import native
from sgmethod.profiles import Tune

# Kept back of a time limit, for writing and measuring the file; what is shared, all threads do together.
RESERVE_S = 0.02
RESERVE_S_PER_MEGAPIXEL, SHARED_S_PER_MEGAPIXEL = 0.1, 0.1
# Of the time so far, what an encode that is to stop takes to its end.
WINDING_DOWN = 0.25


@dataclass(frozen=True)
class Request:
    """Pixels, uint8 [H, W, 3], and what encode() was given with them.

    alpha: uint8 [H, W], what shows of the pixels, where they are not opaque; part: of a time limit that this is to be
    done in, where other things follow.
    """

    pixels: NDArray[np.uint8]
    budget: Budget
    profile: str
    tune: Tune
    effort: int
    seed: int
    recorder: Recorder
    alpha: NDArray[np.uint8] | None = None
    part: float = 1.0

    def until_s(self, share: float = 1.0) -> float | None:
        """The second, on the recorder's clock, at which that share of the time for fitting is over; None without a
        limit. A stop is a limit that comes late: what is left of the schedule is shortened, not cut off.
        """
        clock, found = self.recorder.clock, []
        if clock.limit_s is not None:
            megapixels = float(self.pixels.shape[0] * self.pixels.shape[1]) / 1e6
            reserve_s = RESERVE_S_PER_MEGAPIXEL + SHARED_S_PER_MEGAPIXEL / native.thread_count()
            found.append(share * self.part * (clock.limit_s - RESERVE_S - reserve_s * megapixels))
        stopped_s = clock.stopped_s()
        if stopped_s is not None:
            found.append(stopped_s * (1 + share * WINDING_DOWN))
        return min(found, default=None)

    def left_s(self, share: float = 1.0) -> float:
        """Seconds until then, below 0 once it is over; infinity without a limit."""
        until_s = self.until_s(share)
        return math.inf if until_s is None else until_s - self.recorder.clock.seconds()

    def gaussians_asked(self) -> int:
        """The budget as a number of Gaussians. Raises BudgetError if it is more than pixels."""
        pixels = self.pixels.shape[0] * self.pixels.shape[1]
        if self.budget.value > pixels:
            raise BudgetError(f"{int(self.budget.value)} Gaussians are more than the image's {pixels} pixels")
        return int(self.budget.value)
