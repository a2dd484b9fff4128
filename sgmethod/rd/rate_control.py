"""Rate control: how a budget becomes a quantum, a number of Gaussians, and a way to steer and search both.

One number, the quantum, sets all quantiser steps and the price of a bit. Each kind of budget is a class that answers
the same questions: RateControl here for a quantum that stays as asked, and GaussianCount; byte_limit.py for bytes,
aim.py for a PSNR and for looks, which both steer the quantum while the Gaussians are fitted.

Early in the fit there may be more Gaussians, and a larger file, than the budget allows: growth finds local maxima of a
gain, and the best early additions are not the best late. The surplus is given up step by step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from sgmethod.backend.protocol import NO_LIMIT
from sgmethod.bitstream.texture import Codes
from sgmethod.bitstream.v2 import StreamV2
from sgmethod.decoder import draw_whole
from sgmethod.fitting.objective import Objective
from sgmethod.settings.rd import RdSettings, Times

EXACT_DB = 99.0  # of a picture without any error


def quality_quantum(quality: float) -> float:
    """The quantum of a quality in 0 .. 100: 16 points halve it, 0 is 3.2. On photographs of 0.4 megapixels 25 comes to
    about 0.05 bpp, 50 to 0.2, 75 to 0.8, 100 to 2.3."""
    return 3.2 * 2 ** (-quality / 16)


def looks_db(looks: float) -> float:
    """SSIMULACRA 2 in decibels below the worst that has a name, 0: like PSNR it gains about 2.5 dB when the quantum is
    halved, on photographs from 30 to 90. 0 dB for 0, 5.2 for 70, 10 for 90."""
    return -10 * math.log10(max(100 - looks, 1e-6) / 100)


def error_per_bit(quantum: float) -> float:
    """The squared error, summed over the picture, that one bit buys at the margin: of a uniform quantiser's error
    q^2 / 12 a further bit takes away 3/4, that is -d(q^2 / 12)/d(bits) = q^2 ln(2) / 6."""
    return quantum**2 * math.log(2) / 6


def surplus(times: Times, at: float) -> float:
    """1 while there may be more than was asked for, falling to 0."""
    return 1 - min(max((at - times.excess_from) / (times.excess_until - times.excess_from), 0), 1)


def excess(times: Times, at: float) -> float:
    """The allowance, in multiples of the Gaussians or bytes asked for."""
    return 1 + times.excess * surplus(times, at)


class Measured(Protocol):
    """A coded picture, or a fit that would round to one, with its quality in dB."""

    @property
    def psnr(self) -> float:
        """PSNR in dB."""

    @property
    def looks_db(self) -> float:
        """SSIMULACRA 2, as looks_db() counts it."""


class Fitted(Measured, Protocol):
    """A fit as it stands. Whoever asks for a quality draws a whole picture."""

    @property
    def file_bytes(self) -> int:
        """Size of its file."""

    @property
    def lost_db(self) -> float:
        """PSNR that rounding takes."""


@dataclass(frozen=True)
class Coded:
    """A coded picture, measured without its texture, which is there to be seen and not to be measured."""

    stream: StreamV2
    objective: Objective

    @cached_property
    def error(self) -> float:
        """Squared, as the objective counts it, summed. Measured when it is first asked for."""
        return self.objective.error(draw_whole(self.stream, texture=False))

    @property
    def size(self) -> int:
        """Bytes of the payload."""
        return len(self.stream.payload)

    @property
    def psnr(self) -> float:
        """In dB, for files that are tuned for it."""
        return min(-10 * math.log10(max(self.error, 1e-12) / self.objective.pixels.size), EXACT_DB)

    @cached_property
    def looks_db(self) -> float:
        """SSIMULACRA 2 of the whole file, as looks_db() counts it."""
        return looks_db(self.objective.looks(draw_whole(self.stream)))


@dataclass(frozen=True)
class RateControl:
    """A quantum that stays as it is, for a quality.

    pixels: of the picture; quantum: the first; is_short: the file is to be a short one. Times (`at`) are parts of a run
    of the schedule, 0 to 1.
    """

    settings: RdSettings
    pixels: int
    quantum: float
    is_short: bool = False

    # --- asked while Gaussians are fitted

    def expected_gaussians(self) -> int:
        """A first guess of how many Gaussians there will be."""
        s = self.settings.rate
        return max(min(int(s.gaussians_per_pixel * self.pixels / self.quantum), self.pixels // s.fewest_pixels), 1)

    def most_gaussians(self, settings: RdSettings, times: Times, at: float) -> int:
        """How many Gaussians there may be, under settings that time may have cut."""
        return self.pixels

    def steps(self, settings: RdSettings) -> int:
        """Steps of the first run, under settings that time may have cut."""
        s = settings.schedule
        density = self.expected_gaussians() / self.pixels
        share = min(max((density - s.sparse) / (s.dense - s.sparse), 0), 1)
        return round(settings.effort.steps * (1 + share * (s.dense_steps - 1)))

    def steered(self, quantum: float, times: Times, at: float, fitted: Fitted) -> float:
        """The quantum from `at` on, given the one before. Here it is finer early, where a budget of bytes or a PSNR
        would have steered it to."""
        return self.quantum / float(times.finer_early ** surplus(times, at))

    def allows(self, psnr: Callable[[], float]) -> bool:
        """Whether Gaussians may be dropped that leave this PSNR."""
        return True

    # --- asked while files are searched

    def payload_limit(self, empty: StreamV2) -> int:
        """Bytes that the budget leaves for the payload, beside what a file without any takes."""
        return NO_LIMIT

    def affords(self, texture: Codes) -> bool:
        """Whether the file may hold a texture."""
        return True

    def first_quantum(self, quantum: float, payload: Callable[[float], int], limit: int) -> float:
        """The quantum to try first, given the fit's and the bytes of payload to which its Gaussians come."""
        return self.quantum

    def next_quantum(self, tried: Sequence[Coded], limit: int, size_tries: int) -> float | None:
        """The quantum to try after those tried; None where nothing is to be gained."""
        return None

    def is_cut_short(self, size: int, limit: int) -> bool:
        """Whether a fit that comes to this payload was cut short, and so is also worth coding with fewer Gaussians."""
        return False

    def chosen(self, tried: Sequence[Coded]) -> Coded:
        """The best file of one search."""
        return self.best(tried)

    def relaxed_bytes(self, coded: Coded) -> int:
        """Bytes of payload within which a file is coded again once it is relaxed."""
        return NO_LIMIT

    # --- asked once files are made

    @property
    def further_rounds(self) -> int:
        """Rounds beyond those of the effort, while what is asked for is missed."""
        return 0

    def is_missed(self, files: Iterable[Coded]) -> bool:
        """Whether none of the files has the quality that was asked for."""
        return False

    def best(self, files: Iterable[Coded]) -> Coded:
        """The file that meets the budget best."""
        first, *others = files
        return max([first, *others], key=self.merit) if others else first

    def merit(self, coded: Coded) -> tuple[float, float]:
        """What files of one budget are compared by; the second counts where the first is equal."""
        return -coded.error - 8 * error_per_bit(self.quantum) * coded.size, -coded.size


@dataclass(frozen=True)
class GaussianCount(RateControl):
    """A number of Gaussians, not to be exceeded, at a fixed quality."""

    max_gaussians: int = 1

    @classmethod
    def of(cls, max_gaussians: int, pixels: int, settings: RdSettings) -> GaussianCount:
        """A limit for a picture of so many pixels."""
        quantum = quality_quantum(settings.rate.gaussians_quality)
        return cls(settings, pixels, quantum, max_gaussians=max_gaussians)

    def expected_gaussians(self) -> int:
        """All of them."""
        return self.max_gaussians

    def most_gaussians(self, settings: RdSettings, times: Times, at: float) -> int:
        """More than the limit early."""
        return min(self.pixels, int(self.max_gaussians * excess(times, at)))

    def merit(self, coded: Coded) -> tuple[float, float]:
        """The least error."""
        return -coded.error, -coded.size
