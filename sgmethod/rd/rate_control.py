"""Rate control: how one budget of any kind becomes a quantum, a number of Gaussians, and a way to steer both.

One number, the quantum, sets all quantiser steps and the price of a bit. A budget in bytes or in decibels steers it
while the Gaussians are fitted. A quality sets it once; a number of Gaussians leaves it at a fixed quality.

Early in the fit there may be more Gaussians, and a larger file, than the budget allows: growth finds local maxima of a
gain, and what is added early is not what is best late. The surplus is given up step by step (_surplus).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from sgmethod.bitstream.payload import HEADER_BYTES
from sgmethod.errors import BudgetError
from sgmethod.fitting.request import Request
from sgmethod.profiles import RdSettings

SMALLEST_FILE = HEADER_BYTES  # without any Gaussian there is no payload
GAUSSIANS_QUALITY = 85.0  # at which a number of Gaussians asked for is fitted
# First guesses of how many Gaussians there will be: by the bits of one, and by pixels over the quantum.
BIT_GUESS = 30.0
MOST_BYTES = 12  # that a pixel can use, where each has a Gaussian of its own; more would ask for steps without end
GAUSSIANS_GUESS = 0.0023
PIXELS_OF_FIRST_GUESS = 20  # a Gaussian, at least; growth may put more


def quality_quantum(quality: float) -> float:
    """The quantum of a quality in 0 .. 100: 16 points halve it, 0 is 3.2. On photographs of 0.4 megapixels 25 comes to
    about 0.05 bpp, 50 to 0.2, 75 to 0.8, 100 to 2.3."""
    return 3.2 * 2 ** (-quality / 16)


def quantum_of_psnr(psnr_db: float) -> float:
    """About the quantum of a photograph's file of so many decibels."""
    return 0.1 * 2 ** ((34 - psnr_db) / 2.5)


def psnr_of_quantum(quantum: float) -> float:
    """The other way round."""
    return 34 - 2.5 * math.log2(quantum / 0.1)


@dataclass(frozen=True)
class RateControl:
    """What a budget asks of one picture.

    pixels: of the picture; quantum: the first, and the last one where nothing steers it; max_bytes: of the file, never
    to be exceeded; psnr: dB to reach; max_gaussians: not to be exceeded. At most one of the last three is given.
    Times (`at`) are parts of the schedule, 0 to 1.
    """

    settings: RdSettings
    pixels: int
    quantum: float
    max_bytes: int | None = None
    psnr: float | None = None
    max_gaussians: int | None = None

    @classmethod
    def of(cls, request: Request, settings: RdSettings) -> RateControl:
        """The rate control of a request. Raises BudgetError for a budget that no file can meet."""
        height, width = request.pixels.shape[:2]
        pixels, budget = width * height, request.budget
        if budget.kind == "quality":
            return cls(settings, pixels, quality_quantum(budget.value))
        if budget.kind == "psnr":
            return cls(settings, pixels, min(quantum_of_psnr(budget.value), 0.4), psnr=budget.value)
        if budget.kind == "gaussians":
            quantum = quality_quantum(GAUSSIANS_QUALITY)
            return cls(settings, pixels, quantum, max_gaussians=request.gaussians_asked())
        asked = budget.max_bytes(width, height) or 0
        if asked < SMALLEST_FILE:
            raise BudgetError(f"a file of profile rd takes at least {SMALLEST_FILE} bytes, the budget is {asked}")
        return cls(settings, pixels, 0.0).for_size(asked)

    def for_size(self, max_bytes: int) -> RateControl:
        """The same for a budget of so many bytes, or as many as a file can use."""
        max_bytes = min(max_bytes, self.most_bytes())
        bpp = max(8 * max_bytes / self.pixels, 1e-3)
        return replace(self, quantum=0.15 * (0.25 / bpp) ** 1.1, max_bytes=max_bytes, psnr=None)

    def most_bytes(self) -> int:
        """That a file of the picture can use."""
        return SMALLEST_FILE + MOST_BYTES * self.pixels

    @property
    def has_goal(self) -> bool:
        """Whether a size or a PSNR steers the quantum."""
        return self.max_bytes is not None or self.psnr is not None

    def expected_gaussians(self) -> int:
        """A first guess of how many Gaussians there will be."""
        if self.max_gaussians is not None:
            return self.max_gaussians
        if self.max_bytes is not None:
            return max(min(int(8 * self.max_bytes / BIT_GUESS), self.pixels), 1)
        return max(min(int(GAUSSIANS_GUESS * self.pixels / self.quantum), self.pixels // PIXELS_OF_FIRST_GUESS), 1)

    def steps(self) -> int:
        """Steps of the fit."""
        s = self.settings
        density = self.expected_gaussians() / self.pixels
        share = min(max((density - s.sparse) / (s.dense - s.sparse), 0), 1)
        return round(s.steps * (1 + share * (s.dense_steps - 1)))

    def most_gaussians(self, at: float) -> int:
        """How many Gaussians there may be at a time of the schedule."""
        if self.max_gaussians is not None:
            return min(self.pixels, int(self.max_gaussians * self._excess(at)))
        if self.max_bytes is not None:
            return min(self.pixels, int(self.settings.most * self.expected_gaussians()))
        return self.pixels

    def new_gaussians(self, now: int) -> int:
        """How many Gaussians may be added to so many at once."""
        s = self.settings
        return max(int(s.growth * now), self.expected_gaussians() // len(s.times.growth_at), 4)

    def steered(
        self, quantum: float, at: float, file_bytes: int, psnr: Callable[[], float], unrounded_psnr: Callable[[], float]
    ) -> float:
        """The quantum from this time on, given the quantum now and what it comes to: the file's size, and its PSNR in
        dB and that before rounding, which are asked for where they are needed."""
        s, times = self.settings, self.settings.times
        if not self.has_goal:
            return self._given_quantum(at)
        if at < times.steering_from:
            return quantum
        exponent = s.steering_exponent if at in times.growth_at else s.trim_exponent
        ratio: float
        if self.max_bytes is not None:
            # More than the whole size from the first: the fine steps that this means serve Gaussians well while they
            # are few. Later there are more Gaussians than can stay, and those that gain least for their bits go.
            ratio = (file_bytes / (self.max_bytes * self._excess(at))) ** exponent
        else:
            assert self.psnr is not None
            # Early in the growth a larger error than the final one is right.
            missing = max(1 - (at - times.steering_from) / (times.early_until - times.steering_from), 0)
            aim = self.psnr - times.early_db * missing
            rounded = psnr()
            ratio = 2 ** ((rounded - aim) / s.db_per_doubling * exponent)
            # Where rounding takes next to nothing, a finer quantum cannot give what is missing.
            if ratio < 1 and at > times.growth_at[-1] and unrounded_psnr() < min(rounded + s.missed_db, self.psnr):
                return quantum
        if ratio == 1.0:
            return quantum
        return quantum * min(max(ratio, 1 / s.steering_limit), s.steering_limit)

    def _surplus(self, at: float) -> float:
        """1 while there may be more than was asked for, falling to 0."""
        times = self.settings.times
        return 1 - min(max((at - times.excess_from) / (times.excess_until - times.excess_from), 0), 1)

    def _excess(self, at: float) -> float:
        """How many times what was asked for there may be: Gaussians, or bytes."""
        return 1 + self.settings.times.excess * self._surplus(at)

    def _given_quantum(self, at: float) -> float:
        """The quantum asked for; finer early, where a size or a PSNR would have steered it to."""
        return self.quantum / float(self.settings.times.finer_early ** self._surplus(at))
