"""Rate control that reaches a quality, in SSIMULACRA 2 or PSNR, in as few bytes as possible."""

from __future__ import annotations

import math
import statistics
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from sgmethod.backend.protocol import NO_LIMIT
from sgmethod.bitstream.v2 import MAX_QUANTUM, MIN_QUANTUM, StreamV2, alpha_bytes, quantum_code
from sgmethod.budget import MAX_PSNR_DB
from sgmethod.decoder import draw_whole
from sgmethod.errors import BudgetError
from sgmethod.io.compositing import on_backgrounds
from sgmethod.metrics import psnr, ssimulacra2
from sgmethod.metrics.visual import SMALLEST_SIDE
from sgmethod.rd.byte_limit import MIN_USED, alpha_limit, fitting_quantum
from sgmethod.rd.rate_control import (
    STEERING_LIMIT,
    Attempts,
    Coded,
    Fitted,
    Measured,
    RateControl,
    coarsened,
    exponent,
    ssimulacra2_db,
)
from sgmethod.scene import Pixels
from sgmethod.settings.rd import Effort, Times

COARSEST = 0.4  # first quantum
QUALITY_QUANTUM = (70.0, 0.16)  # a quality, and a typical quantum of photographs there
# Pixels of a side, and factor on the quantum of smaller pictures, which SSIMULACRA 2 judges more harshly.
QUALITY_SMALL = (113, 0.25)
QUALITY_LIMIT = 1.8  # STEERING_LIMIT where SSIMULACRA 2 is measured, which is seldom
QUALITY_REFINED_DB = 0.35  # least gain of refining
DB_PER_DOUBLING = 2.5  # PSNR lost when the quantum doubles
EARLY_UNTIL = 0.45  # end of the time when the aim is lower, by Times.early_db at first
SLACK_DB = 0.05  # a PSNR this far above the requested one is close enough
MIN_GAIN = 0.1  # part of the expected gain of a finer quantum; if it gains less, it is finer than needed
MISSED_DB = 0.1  # if a PSNR is out of reach, one this far below the best seen is enough
PRUNED_DB = 0.1  # no Gaussians are dropped if that would take the PSNR this far below the requested one
# When a file is coded again: least saving, further saving per dB above the requested PSNR, and largest saving, as parts
# of its size.
LEAST_SAVED, SAVED_PER_DB, MOST_SAVED = 0.005, 0.3, 0.05
MAX_ERROR_OF_ALPHA = 0.3  # of the error that a PSNR allows


@dataclass(frozen=True)
class Aim(RateControl, ABC):
    """Rate control for a quality of aim_db.

    tries: limit on the files with different quanta; steering_limit: largest factor by which the quantum changes at one
    time; refined_db: quality that refining will add; below_best_db: distance below the best try that will do if the aim
    is out of reach; round_slack_db: a smaller miss is not worth another round.
    """

    usual_tries = 4
    tries: ClassVar[int]
    steering_limit: ClassVar[float]
    below_best_db: ClassVar[float]
    round_slack_db: ClassVar[float]

    aim_db: float = 0.0
    refined_db: float = 0.0

    @abstractmethod
    def reached(self, picture: Measured) -> float:
        """Measure the quality of a picture in dB."""

    def steered(self, quantum: float, times: Times, at: float, fitted: Fitted) -> float:
        """Steer towards the quality; early in the growth, a larger error than the final one is right."""
        if at < times.steering_from:
            return quantum
        missing = max(1 - (at - times.steering_from) / (EARLY_UNTIL - times.steering_from), 0)
        above = self.reached(fitted) - self.aim_db + self.refined_db
        ratio = 2 ** ((above + times.early_db * missing) / DB_PER_DOUBLING * exponent(times, at))
        # If rounding loses next to nothing, a finer quantum cannot add what is missing.
        if ratio < 1 and at > times.growth_at[-1] and fitted.lost_db < min(MISSED_DB, -above):
            return quantum
        return float(quantum * min(max(ratio, 1 / self.steering_limit), self.steering_limit))

    def first_quantum(self, quantum: float, payload: Callable[[float], int], limit: int, attempts: Attempts) -> float:
        return quantum

    def next_quantum(self, tried: Sequence[Coded], limit: int, size_tries: int) -> float | None:
        """Return the quantum that should just reach the quality, or None if nothing is between those tried."""
        aim = self._reachable(tried)
        above = [self.reached(one) - aim for one in tried]
        if len(tried) >= self.tries or 0 <= above[-1] <= SLACK_DB:
            return None
        known = {quantum_code(one.stream.quantum) for one in tried}
        points = [(math.log2(one.stream.quantum), y) for one, y in zip(tried, above, strict=True)]
        found = self._nearer(points)
        finer = max((x for x, y in points if y >= 0), default=-math.inf)
        coarser = min((x for x, y in points if y < 0 and x > finer), default=math.inf)
        if math.isfinite(finer - coarser) and (quantum_code(2**found) in known or not finer < found < coarser):
            found = (finer + coarser) / 2
        return None if quantum_code(2**found) in known else float(2**found)

    def chosen(self, tried: Sequence[Coded]) -> Coded:
        """Choose the best file for the quality that is within reach."""
        return replace(self, aim_db=self._reachable(tried)).best(tried)

    def relaxed_bytes(self, coded: Coded) -> int:
        """Size at which a file that is better than asked should have about the quality asked for."""
        above = self.reached(coded) - self.aim_db
        if above < 0:
            return NO_LIMIT
        return int(coded.size * (1 - LEAST_SAVED - min(SAVED_PER_DB * above, MOST_SAVED)))

    def is_enough(self, coded: Coded) -> bool:
        """Never: a better file than asked is made smaller."""
        return False

    def is_missed(self, files: Iterable[Coded]) -> bool:
        return max(map(self.reached, files)) < self.aim_db - self.round_slack_db

    def merit(self, coded: Coded) -> tuple[float, float]:
        """Quality up to the one asked for, then size."""
        return min(self.reached(coded), self.aim_db), -coded.size

    @abstractmethod
    def reached_on_backgrounds(self, decoded: Pixels, source: Pixels) -> float:
        """Measure pictures [2, H, W, 3] in dB."""

    def missing_db(self, stream: StreamV2, source: Pixels) -> float:
        decoded = on_backgrounds(draw_whole(stream))
        return max(self.aim_db - self.reached_on_backgrounds(decoded, on_backgrounds(source)), 0.0)

    def with_higher_target(self, by_db: float) -> Aim:
        return replace(self, aim_db=min(self.aim_db + by_db + SLACK_DB / 2, MAX_PSNR_DB))

    def _reachable(self, tried: Sequence[Coded]) -> float:
        """Quality to aim at, in dB: about the best quality tried, if a finer quantum hardly helps any more."""
        reached = self.reached
        best = max(map(reached, tried))
        if len(tried) < 2 or best >= self.aim_db:
            return self.aim_db
        finest, finer = sorted(tried, key=lambda one: one.stream.quantum)[:2]
        octaves = math.log2(finer.stream.quantum / finest.stream.quantum)
        if reached(finest) - reached(finer) >= MIN_GAIN * DB_PER_DOUBLING * octaves:
            return self.aim_db
        return best - self.below_best_db

    def _nearer(self, points: Sequence[tuple[float, float]]) -> float:
        """Logarithm of the quantum at which the line through the two nearest tries reaches the aim, or a little more.

        points: logarithm of the quantum and distance above the aim of each try.
        """
        slope = -DB_PER_DOUBLING / 2  # of a set of Gaussians that is not fitted again
        (x, y), *others = sorted(points, key=lambda point: abs(point[1]))
        if others and others[0][0] != x:
            x1, y1 = others[0]
            slope = min(max((y1 - y) / (x1 - x), 2 * slope), slope / 4)
        # Near the aim, chance decides, so each near miss asks for a little more.
        near_misses = sum(-SLACK_DB < y < 0 for _, y in points)
        at = x + (0.4 * (1 + near_misses) * SLACK_DB - y) / slope
        return min(max(at, math.log2(MIN_QUANTUM)), math.log2(MAX_QUANTUM))


@dataclass(frozen=True)
class PsnrAim(Aim):
    """Rate control for a PSNR to reach."""

    further_rounds = 2
    tries = 7
    steering_limit = STEERING_LIMIT
    below_best_db = MISSED_DB
    round_slack_db = 0.0

    @classmethod
    def from_psnr(cls, db: float, pixels: int) -> PsnrAim:
        """Create the aim for a picture of `pixels` pixels, with about the quantum that a photograph needs."""
        return cls(pixels, min(0.1 * 2 ** ((34 - db) / DB_PER_DOUBLING), COARSEST), aim_db=db)

    def reached(self, picture: Measured) -> float:
        """PSNR in dB."""
        return picture.psnr

    def reached_on_backgrounds(self, decoded: Pixels, source: Pixels) -> float:
        return min(psnr(decoded, source), 120.0)

    def allows_alpha(self, error: float) -> bool:
        """Whether alpha alone makes no more than its share of the error that the PSNR allows."""
        return error <= MAX_ERROR_OF_ALPHA * 10 ** (-self.aim_db / 10)

    def beside_alpha(self, alpha: StreamV2, error: float) -> PsnrAim:
        allowed = 10 ** (-self.aim_db / 10)
        return replace(self, aim_db=min(-10 * math.log10(max(allowed - error, allowed / 4)), MAX_PSNR_DB))

    def allows(self, psnr: Callable[[], float]) -> bool:
        """Whether about the PSNR is left: after growth, no Gaussian would come back."""
        return psnr() >= self.aim_db - PRUNED_DB


@dataclass(frozen=True)
class QualityAim(Aim):
    """Rate control for a SSIMULACRA 2 to reach, as ssimulacra2_db() counts it."""

    further_rounds = 1
    tries = 5
    steering_limit = QUALITY_LIMIT
    below_best_db = 0.0
    round_slack_db = SLACK_DB

    @classmethod
    def from_score(
        cls, score: float, size: tuple[int, int], effort: Effort, max_bytes: int | None = None
    ) -> QualityAim:
        """Create the aim for a picture of size (width, height), with about the quantum that a photograph needs.

        max_bytes: a limit on the file too. Raises BudgetError for sides that are too small for SSIMULACRA 2.
        """
        if min(size) < SMALLEST_SIDE:
            raise BudgetError(f"quality is undefined for sides below {SMALLEST_SIDE} pixels")
        aim, (known, quantum) = ssimulacra2_db(score), QUALITY_QUANTUM
        quantum *= 2 ** ((ssimulacra2_db(known) - aim) / DB_PER_DOUBLING)
        if min(size) < QUALITY_SMALL[0]:
            quantum *= QUALITY_SMALL[1]
        refined_db = QUALITY_REFINED_DB if effort.refine_sweeps else 0.0
        limit = NO_LIMIT if max_bytes is None else max_bytes
        return cls(size[0] * size[1], min(quantum, COARSEST), max_bytes=limit, aim_db=aim, refined_db=refined_db)

    def reached(self, picture: Measured) -> float:
        """SSIMULACRA 2, as ssimulacra2_db() counts it."""
        return picture.ssimulacra2_db

    def reached_on_backgrounds(self, decoded: Pixels, source: Pixels) -> float:
        found = map(ssimulacra2, decoded, source)
        return ssimulacra2_db(statistics.fmean(one for one in found if one is not None))

    def steered(self, quantum: float, times: Times, at: float, fitted: Fitted) -> float:
        """Steer seldom, since measuring takes as long as steps, and never beyond the bytes that are allowed."""
        steered = super().steered(quantum, times, at, fitted) if at in times.quality_at else quantum
        of_bytes = coarsened(self.max_bytes, times, at, fitted.file_bytes)
        return float(max(steered, quantum * min(of_bytes, STEERING_LIMIT)))

    def first_quantum(self, quantum: float, payload: Callable[[float], int], limit: int, attempts: Attempts) -> float:
        return quantum if payload(quantum) <= limit else fitting_quantum(quantum, payload, limit, attempts)

    def next_quantum(self, tried: Sequence[Coded], limit: int, size_tries: int) -> float | None:
        """Return None too once the bytes are used."""
        return None if tried[-1].size >= MIN_USED * limit else super().next_quantum(tried, limit, size_tries)

    def is_missed(self, files: Iterable[Coded]) -> bool:
        """Whether the quality is missed although there are bytes for more."""
        return super().is_missed(files) and max(one.size for one in files) < MIN_USED * self.max_bytes

    def for_alpha(self) -> RateControl:
        if self.max_bytes == NO_LIMIT:
            return super().for_alpha()
        return alpha_limit(self.pixels, self._quantum_of_alpha, self.max_bytes)

    def beside_alpha(self, alpha: StreamV2, error: float) -> QualityAim:
        return self if self.max_bytes == NO_LIMIT else replace(self, max_bytes=self.max_bytes - alpha_bytes(alpha))

    def missing_db(self, stream: StreamV2, source: Pixels) -> float:
        is_full = stream.file_bytes >= MIN_USED * self.max_bytes
        return 0.0 if is_full else super().missing_db(stream, source)

    def quantum_after_miss(self, quantum: float, files: Iterable[Coded]) -> float:
        """Return a quantum that is finer by as much as is missing."""
        reached = max(map(self.reached, files))
        return float(quantum * max(2 ** ((reached - self.aim_db) / DB_PER_DOUBLING), 1 / QUALITY_LIMIT))
