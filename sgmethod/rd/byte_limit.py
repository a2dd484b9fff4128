"""Rate control of a budget of bytes, which is never exceeded."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from sgmethod.bitstream.v2 import (
    MAX_QUANTUM,
    MIN_QUANTUM,
    SHORT_BYTES,
    SMALLEST_ALPHA,
    SMALLEST_FILE,
    StreamV2,
    alpha_bytes,
)
from sgmethod.errors import BudgetError
from sgmethod.fitting.level import PIXELS_PER_GAUSSIAN
from sgmethod.fitting.objective import Objective
from sgmethod.rd.rate_control import (
    STEERING_LIMIT,
    Attempts,
    Coded,
    Fitted,
    RateControl,
    coarsened,
)
from sgmethod.settings.rd import Times

PRECISION = 1e-3  # of a quantum, as a part
QUANTUM_TRIES = 8  # sizes, once the first quantum lies between two
OCTAVES = 64  # more than there are quanta
LONG_FILE, ITS_ALPHA = 20, 12  # bytes that certainly hold a header that is not short, and what alpha adds
BITS_PER_GAUSSIAN = 30.0  # first guess
CROWD, CROWD_WHEN_SHORT = 5.0, 1.3  # ByteLimit.crowd, and if time is too short for the lowest effort
MAX_BYTES = 12  # that a pixel can use, with one Gaussian for each pixel
MAX_BYTES_OF_ALPHA = 0.6  # of a budget
MIN_USED = 0.985  # of the allowed bytes; if refining uses less, a finer quantum is tried
QUANTUM_PER_SIZE = 1.4  # the quantum is about proportional to this power of the size's inverse
OVERSHOOT_RATIO = 1.1  # of the allowed bytes; a larger fit was cut short: fewer Gaussians are tried too


@dataclass(frozen=True)
class ByteLimit(RateControl):
    """Rate control for a file of at most max_bytes whose quantum is fixed.

    crowd: most Gaussians, in multiples of the expected number.
    """

    weighs_size = False

    crowd: float = CROWD

    def expected_gaussians(self) -> int:
        """The quantum's number, if there are bytes for it."""
        return min(super().expected_gaussians(), max(self._gaussians_by_size(), 1))

    def _gaussians_by_size(self) -> int:
        return int(8 * self.max_bytes / BITS_PER_GAUSSIAN)

    def allowed_gaussians(self, times: Times, at: float) -> int:
        """Several times the expected number: some take few bits."""
        return min(super().allowed_gaussians(times, at), int(self.crowd * self.expected_gaussians()))

    def with_fewer(self) -> ByteLimit:
        return replace(self, crowd=CROWD_WHEN_SHORT)


@dataclass(frozen=True)
class ByteBudget(ByteLimit):
    """Rate control for a budget of bytes: the quantum is steered so that the file uses them."""

    @classmethod
    def from_bytes(cls, max_bytes: int, pixels: int, *, has_alpha: bool) -> ByteBudget:
        """Create the budget for a picture of `pixels` pixels. Raises BudgetError if no file is as small."""
        least = SMALLEST_FILE + has_alpha * SMALLEST_ALPHA
        if max_bytes < least:
            kind = "a file with alpha" if has_alpha else "a file of profile rd"
            raise BudgetError(f"{kind} takes at least {least} bytes, the budget is {max_bytes}")
        return cls(pixels, 0.0).for_bytes(max_bytes)

    def for_bytes(self, max_bytes: int) -> ByteBudget:
        """Return the same for another number of bytes, at most as many as a file can use.

        A picture with more pixels than its Gaussians need counts as reduced to these.
        """
        max_bytes = min(max_bytes, SMALLEST_FILE + MAX_BYTES * self.pixels)
        bits = 8 * max_bytes
        pixels = min(self.pixels, PIXELS_PER_GAUSSIAN * bits / BITS_PER_GAUSSIAN)
        # Quanta grow with the side of the whole picture.
        quantum = 0.15 * (0.25 * pixels / bits) ** 1.1 * math.sqrt(self.pixels / pixels)
        return replace(self, quantum=quantum, max_bytes=max_bytes)

    def is_short(self, objective: Objective, *, has_alpha: bool) -> bool:
        """A small file is short, unless its background is most of the picture and there are bytes for all its bits."""
        if self.max_bytes > SHORT_BYTES:
            return False
        return self.max_bytes < LONG_FILE + has_alpha * ITS_ALPHA or not objective.histogram.has_majority

    def for_alpha(self) -> ByteLimit:
        return alpha_limit(self.pixels, self._quantum_of_alpha, self.max_bytes)

    def beside_alpha(self, alpha: StreamV2, error: float) -> ByteBudget:
        return self.for_bytes(self.max_bytes - alpha_bytes(alpha))

    def expected_gaussians(self) -> int:
        return max(min(self._gaussians_by_size(), self.pixels), 1)

    def steered(self, quantum: float, times: Times, at: float, fitted: Fitted) -> float:
        """Steer towards the whole size, and a surplus early.

        Few Gaussians are served well by the fine steps that this means. Later there are more than can stay, and those
        that gain least for their bits go.
        """
        if at < times.steering_from:
            return quantum
        ratio = coarsened(self.max_bytes, times, at, fitted.file_bytes)
        return quantum * min(max(ratio, 1 / STEERING_LIMIT), STEERING_LIMIT)

    def first_quantum(self, quantum: float, payload: Callable[[float], int], limit: int, attempts: Attempts) -> float:
        return fitting_quantum(quantum, payload, limit, attempts)

    def next_quantum(self, tried: Sequence[Coded], limit: int, size_tries: int) -> float | None:
        """Return a finer one while bytes are left: refining saves a percent or, after a short fit, a fifth."""
        last = tried[-1]
        used = last.size / max(limit, 1)
        if len(tried) > size_tries or used >= MIN_USED or used == 0:
            return None
        return last.stream.quantum * float(used**QUANTUM_PER_SIZE)

    def is_cut_short(self, size: int, limit: int) -> bool:
        return size > OVERSHOOT_RATIO * limit


def alpha_limit(pixels: int, quantum: float, max_bytes: int) -> ByteLimit:
    """Rate control for the alpha of a file of at most max_bytes: it takes what it is worth, up to its part of them."""
    spare = max_bytes - SMALLEST_FILE - SMALLEST_ALPHA
    return ByteLimit(pixels, quantum, max_bytes=StreamV2.MIN_BYTES + int(MAX_BYTES_OF_ALPHA * spare))


def fitting_quantum(quantum: float, payload: Callable[[float], int], limit: int, attempts: Attempts) -> float:
    """Search for the finest quantum at which all Gaussians fit. If even the coarsest fails, refining drops some.

    Bisection, at the place where the line through both ends meets the limit. The end that stays counts half each
    time (Illinois), so that both move. If time is over before the limit lies between both ends, a guess has to do.
    """

    def beyond(log_quantum: float) -> float:
        return math.log(max(payload(math.exp(log_quantum)), 1) / max(limit, 1))

    low, high = math.log(0.9 * quantum), math.log(1.02 * quantum)
    above, octaves = beyond(high), attempts(OCTAVES)
    for _ in octaves:
        if above <= 0 or high >= math.log(MAX_QUANTUM):
            break
        low, high = high, high + math.log(2)
        above = beyond(high)
    else:
        return math.exp(high + 1.5 * max(above, 0.0))  # bytes fall as about the power of -2/3
    below = beyond(low)
    for _ in octaves:
        if below >= 0 or low <= math.log(MIN_QUANTUM):
            break
        low, high, above = low - math.log(2), low, below
        below = beyond(low)
    for _ in attempts(QUANTUM_TRIES):
        if high - low < PRECISION:
            break
        middle = low + (high - low) * min(max(below / max(below - above, 1e-9), 0.02), 0.98)
        at_middle = beyond(middle)
        if at_middle <= 0:
            high, above, below = middle, at_middle, below / 2
        else:
            low, below, above = middle, at_middle, above / 2
    return math.exp(high)
