"""Rate control: a budget becomes a quantum and a number of Gaussians, which the fit steers and the search refines.

One number, the quantum, sets all quantiser steps and the price of a bit. Each kind of budget is a class that answers
the same questions. RateControl (a fixed quantum) and GaussianCount are here. byte_limit.py has the class for bytes.
aim.py has the classes for a SSIMULACRA 2 and for a PSNR, which steer the quantum while the Gaussians are fitted.

Early in the fit there may be more Gaussians, and a larger file, than the budget allows: growth adds Gaussians at local
maxima of the gain, and the best places early in the fit are not the best places at its end. The surplus is dropped step
by step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Protocol

from sgmethod.backend.protocol import NO_LIMIT
from sgmethod.bitstream.v2 import MAX_QUANTUM, StreamV2
from sgmethod.budget import MAX_GAUSSIANS
from sgmethod.decoder import draw_whole
from sgmethod.fitting.objective import Objective
from sgmethod.scene import Pixels
from sgmethod.settings.rd import Times

EXACT_DB = 99.0  # PSNR of a picture without any error
GAUSSIANS_PER_PIXEL = 0.0023  # first guess, times the quantum
MIN_PIXELS = 20  # per Gaussian in a first guess; growth may go beyond
GAUSSIANS_QUANTUM = 3.2 * 2 ** (-85 / 16)  # for a budget of Gaussians: about 1.2 bpp on photographs
STEERING_EXPONENT = 0.9  # at the times of growth
TRIM_EXPONENT = 1.0  # later
STEERING_LIMIT = 1.35  # largest change of the quantum at one time, as a factor
# Quantum of alpha, in multiples of that of colours: an error of alpha counts in one channel instead of three, and its
# fit also pays for errors beyond black and white, which decoding clamps.
COARSER_ALPHA = 6.0
MAX_GAUSSIANS_OF_ALPHA = 0.25  # of a budget of Gaussians


def ssimulacra2_db(score: float) -> float:
    """Convert SSIMULACRA 2 to decibels: 0 dB for 0, 5.2 for 70, 10 for 90.

    Like PSNR, it then gains about 2.5 dB when the quantum is halved, on photographs from 30 to 90.
    """
    return -10 * math.log10(max(100 - score, 1e-6) / 100)


def error_per_bit(quantum: float) -> float:
    """Return the squared error, summed over the picture, that one more bit saves.

    A further bit takes away 3/4 of a uniform quantiser's error q^2 / 12: -d(q^2 / 12)/d(bits) = q^2 ln(2) / 6.
    """
    return quantum**2 * math.log(2) / 6


def surplus(times: Times, at: float) -> float:
    """Share of the surplus that is allowed at a time: 1 at first, falling to 0."""
    return 1 - min(max((at - times.excess_from) / (times.excess_until - times.excess_from), 0), 1)


def excess(times: Times, at: float) -> float:
    """Allowance in multiples of the Gaussians or bytes asked for."""
    return 1 + times.excess * surplus(times, at)


def exponent(times: Times, at: float) -> float:
    """Return how far the quantum goes towards what would meet the budget: 1 is all the way."""
    return STEERING_EXPONENT if at in times.growth_at else TRIM_EXPONENT


def coarsened(max_bytes: int, times: Times, at: float, file_bytes: int) -> float:
    """Return the factor on the quantum by which a file of file_bytes would meet a limit, early with its surplus."""
    return float((file_bytes / (max_bytes * excess(times, at))) ** exponent(times, at))


Attempts = Callable[[int], Iterable[int]]  # from a limit to as many as there is time for, at least one


class Measured(Protocol):
    """A coded picture, or a fit that could be coded: its PSNR, and its SSIMULACRA 2 as ssimulacra2_db() counts it."""

    @property
    def psnr(self) -> float: ...
    @property
    def ssimulacra2_db(self) -> float: ...


class Fitted(Measured, Protocol):
    """A fit as it stands: also the size of its file, and the PSNR that rounding takes. Each quality takes a drawing."""

    @property
    def file_bytes(self) -> int: ...
    @property
    def lost_db(self) -> float: ...


@dataclass(frozen=True)
class Coded:
    """A coded picture. `error` leaves the texture out, which is there to be seen; `ssimulacra2_db` includes it."""

    stream: StreamV2
    objective: Objective

    @cached_property
    def error(self) -> float:
        """Sum of squared errors, as the objective counts them."""
        return self.objective.error(draw_whole(self.stream, texture=False))

    @property
    def size(self) -> int:
        """Size of the payload in bytes."""
        return len(self.stream.payload)

    @property
    def psnr(self) -> float:
        """PSNR in dB, if the file is tuned for it."""
        return min(-10 * math.log10(max(self.error, 1e-12) / self.objective.pixels.size), EXACT_DB)

    @cached_property
    def ssimulacra2_db(self) -> float:
        """SSIMULACRA 2 of the whole file, on the scale of the function of this name."""
        return ssimulacra2_db(self.objective.ssimulacra2(draw_whole(self.stream)))


@dataclass(frozen=True)
class RateControl:
    """Rate control at a fixed quantum. Each kind of budget overrides the methods that it answers differently.

    pixels: size of the picture; quantum: the initial quantum; further_rounds: rounds beyond the effort's, while the
    budget is missed; max_bytes, max_gaussians: limits on the file; usual_tries: quanta that a search usually tries;
    weighs_size: whether a smaller file makes up for a larger error. Times (`at`) are parts of a run of the schedule, 0
    to 1.
    """

    usual_tries: ClassVar[int] = 1
    weighs_size: ClassVar[bool] = True
    further_rounds: ClassVar[int] = 0

    pixels: int
    quantum: float
    max_bytes: int = NO_LIMIT
    max_gaussians: int = MAX_GAUSSIANS

    # --- asked while Gaussians are fitted

    def expected_gaussians(self) -> int:
        """First guess of the number of Gaussians."""
        return max(min(int(GAUSSIANS_PER_PIXEL * self.pixels / self.quantum), self.pixels // MIN_PIXELS), 1)

    def allowed_gaussians(self, times: Times, at: float) -> int:
        """Limit on the number of Gaussians, with a surplus early."""
        return min(self.pixels, MAX_GAUSSIANS, int(self.max_gaussians * excess(times, at)))

    def with_fewer(self) -> RateControl:
        """Return the same with fewer Gaussians, if it decides how many, for time too short for the lowest effort."""
        return self

    def steered(self, quantum: float, times: Times, at: float, fitted: Fitted) -> float:
        """Return the quantum from `at` on, given the one before.

        A fixed quantum is finer early, as a budget of bytes or a PSNR would have steered it.
        """
        return self.quantum / float(times.finer_early ** surplus(times, at))

    def allows(self, psnr: Callable[[], float]) -> bool:
        """Whether Gaussians may be dropped if this PSNR is left."""
        return True

    # --- asked while files are searched

    def is_short(self, objective: Objective, *, has_alpha: bool) -> bool:
        """Whether to write a short file, which rounds its background."""
        return False

    def first_quantum(self, quantum: float, payload: Callable[[float], int], limit: int, attempts: Attempts) -> float:
        """Return the quantum to try first, given the fit's and a function from a quantum to bytes of payload."""
        return self.quantum

    def next_quantum(self, tried: Sequence[Coded], limit: int, size_tries: int) -> float | None:
        """Return the quantum to try next, or None if nothing is to be gained."""
        return None

    def is_cut_short(self, size: int, limit: int) -> bool:
        """Whether a fit with this payload was cut short, and so is also worth coding with fewer Gaussians."""
        return False

    def chosen(self, tried: Sequence[Coded]) -> Coded:
        """Choose the best file of one search."""
        return self.best(tried)

    def relaxed_bytes(self, coded: Coded) -> int:
        """Limit on the payload when a file is coded again after relaxing."""
        return NO_LIMIT

    # --- asked where a picture has alpha, which is encoded before its colours (alpha.py)

    def for_alpha(self) -> RateControl:
        """Rate control for the alpha plane."""
        return RateControl(self.pixels, self._quantum_of_alpha)

    @property
    def _quantum_of_alpha(self) -> float:
        return min(COARSER_ALPHA * self.quantum, MAX_QUANTUM)

    def allows_alpha(self, error: float) -> bool:
        """Whether alpha may cause this mean squared error in a file with exact colours."""
        return True

    def beside_alpha(self, alpha: StreamV2, error: float) -> RateControl:
        """Rate control for the colours of a file whose alpha plane is coded, and alone causes this error."""
        return self

    def missing_db(self, stream: StreamV2, source: Pixels) -> float:
        """How far a file with alpha is below the quality asked for. source: [H, W, 4]."""
        return 0.0

    def with_higher_target(self, by_db: float) -> RateControl:
        """Return the same with a higher quality to reach, if it has one; by_db: by how much at least."""
        return self

    # --- asked once files are made

    def is_missed(self, files: Iterable[Coded]) -> bool:
        """Whether none of the files has the quality that was asked for."""
        return False

    def quantum_after_miss(self, quantum: float, files: Iterable[Coded]) -> float:
        """Return the quantum for a further round after files that missed the budget."""
        return quantum

    def is_enough(self, coded: Coded) -> bool:
        """Whether further steps and bytes gain nothing: every pixel is exact."""
        return coded.error == 0

    def best(self, files: Iterable[Coded]) -> Coded:
        """Choose the file that meets the budget best."""
        first, *others = files
        return max([first, *others], key=self.merit) if others else first

    def merit(self, coded: Coded) -> tuple[float, float]:
        """Key by which files of one budget are compared."""
        price = 8 * error_per_bit(self.quantum) if self.weighs_size else 0.0
        return -coded.error - price * coded.size, -coded.size


@dataclass(frozen=True)
class GaussianCount(RateControl):
    """Rate control for a number of Gaussians, which is never exceeded, at a fixed quantum."""

    weighs_size = False

    def expected_gaussians(self) -> int:
        return self.max_gaussians

    def for_alpha(self) -> RateControl:
        limit = max(int(MAX_GAUSSIANS_OF_ALPHA * self.max_gaussians), 1)
        return replace(self, quantum=self._quantum_of_alpha, max_gaussians=limit)

    def beside_alpha(self, alpha: StreamV2, error: float) -> RateControl:
        used = len(alpha.gaussians()) if alpha.payload else 0
        return replace(self, max_gaussians=max(self.max_gaussians - used, 1))
