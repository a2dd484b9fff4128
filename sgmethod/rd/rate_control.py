"""Rate control: how a budget becomes a quantum, a number of Gaussians, and a way to steer and search both.

One number, the quantum, sets all quantiser steps and the price of a bit. A budget in bytes or in decibels steers it
while the Gaussians are fitted. A quality sets it once; a number of Gaussians leaves it at a fixed quality.

Early in the fit there may be more Gaussians, and a larger file, than the budget allows: growth finds local maxima of a
gain, and the best early additions are not the best late. The surplus is given up step by step (_surplus).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from sgmethod.backend.protocol import NO_LIMIT
from sgmethod.bitstream.texture import Codes, pack
from sgmethod.bitstream.v2 import (
    MAX_QUANTUM,
    MIN_QUANTUM,
    SHORT_BYTES,
    SMALLEST_ALPHA,
    SMALLEST_FILE,
    StreamV2,
    alpha_bytes,
    quantum_code,
)
from sgmethod.budget import MAX_PSNR_DB, Budget
from sgmethod.decoder import draw_whole
from sgmethod.errors import BudgetError
from sgmethod.fitting.objective import Objective
from sgmethod.metrics.looks import SMALLEST_SIDE
from sgmethod.settings.rd import RdSettings, Times

LONG_FILE = 32  # bytes that surely hold the header that is not short, with alpha
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
        """Of the whole file."""
        return looks_db(self.objective.looks(draw_whole(self.stream)))


@dataclass(frozen=True)
class RateControl:
    """What a budget asks of one picture.

    pixels: of the picture; quantum: the first, and the last one where nothing steers it; max_bytes: of the file, never
    to be exceeded; aim_db: the PSNR to reach or, by_looks, SSIMULACRA 2 as looks_db; max_gaussians: not to be exceeded;
    is_steered: the quantum follows max_bytes or aim_db; is_short: the file is to be a short one. Times (`at`) are parts
    of a run of the schedule, 0 to 1.
    """

    settings: RdSettings
    pixels: int
    quantum: float
    max_bytes: int | None = None
    aim_db: float | None = None
    by_looks: bool = False
    max_gaussians: int | None = None
    is_steered: bool = True
    is_short: bool = False

    @classmethod
    def of(cls, budget: Budget, size: tuple[int, int], settings: RdSettings, *, has_alpha: bool = False) -> RateControl:
        """For a picture of size (width, height). Raises BudgetError for a budget that no file can meet."""
        pixels, s = size[0] * size[1], settings.rate
        if budget.kind == "quality":
            return cls(settings, pixels, quality_quantum(budget.value))
        if budget.kind == "psnr":
            of_photograph = 0.1 * 2 ** ((34 - budget.value) / s.db_per_doubling)  # about
            return cls(settings, pixels, min(of_photograph, s.coarsest_of_aim), aim_db=budget.value)
        if budget.kind == "looks":
            if min(size) < SMALLEST_SIDE:
                raise BudgetError(f"looks are undefined for sides below {SMALLEST_SIDE} pixels")
            (looks, quantum), aim = s.looks_quantum, looks_db(budget.value)
            of_photograph = quantum * 2 ** ((looks_db(looks) - aim) / s.db_per_doubling)
            if min(size) < s.looks_small[0]:
                of_photograph *= s.looks_small[1]
            return cls(settings, pixels, min(of_photograph, s.coarsest_of_aim), aim_db=aim, by_looks=True)
        if budget.kind == "gaussians":
            quantum = quality_quantum(s.gaussians_quality)
            return cls(settings, pixels, quantum, max_gaussians=budget.max_gaussians(*size))
        asked, least = budget.max_bytes(*size) or 0, SMALLEST_FILE + has_alpha * SMALLEST_ALPHA
        if asked < least:
            kind = "a file with alpha" if has_alpha else "a file of profile rd"
            raise BudgetError(f"{kind} takes at least {least} bytes, the budget is {asked}")
        return cls(settings, pixels, 0.0, is_short=asked <= SHORT_BYTES).for_bytes(asked)

    def for_exact_background(self) -> RateControl:
        """The same for a file that is not short and rounds no background, where a budget has the bytes that this
        takes."""
        return replace(self, is_short=(self.max_bytes or 0) < LONG_FILE)

    def for_bytes(self, max_bytes: int) -> RateControl:
        """The same for a budget of bytes, or as many as a file can use."""
        max_bytes = min(max_bytes, SMALLEST_FILE + self.settings.rate.most_bytes * self.pixels)
        bits, s = 8 * max_bytes, self.settings
        # Of a picture with more pixels than its Gaussians need, reduced to as many. Quanta grow with a picture's side.
        pixels = min(self.pixels, s.pyramid.pixels_per_gaussian * bits / s.rate.bits_per_gaussian)
        quantum = 0.15 * (0.25 * pixels / bits) ** 1.1 * math.sqrt(self.pixels / pixels)
        return replace(self, quantum=quantum, max_bytes=max_bytes, aim_db=None)

    def expected_gaussians(self) -> int:
        """A first guess of how many Gaussians there will be."""
        s = self.settings.rate
        if self.max_gaussians is not None:
            return self.max_gaussians
        by_quantum = int(s.gaussians_per_pixel * self.pixels / self.quantum)
        guess = min(by_quantum, self.pixels // s.fewest_pixels)
        if self.max_bytes is not None:
            by_size = int(8 * self.max_bytes / s.bits_per_gaussian)
            guess = by_size if self.is_steered else min(guess, by_size)
        return max(min(guess, self.pixels), 1)

    def steps(self, settings: RdSettings) -> int:
        """Steps of the first run, under settings that time may have cut."""
        s = settings.schedule
        density = self.expected_gaussians() / self.pixels
        share = min(max((density - s.sparse) / (s.dense - s.sparse), 0), 1)
        return round(settings.effort.steps * (1 + share * (s.dense_steps - 1)))

    def most_gaussians(self, settings: RdSettings, times: Times, at: float) -> int:
        """How many Gaussians there may be at a time of the schedule."""
        if self.max_gaussians is not None:
            return min(self.pixels, int(self.max_gaussians * _excess(times, at)))
        if self.max_bytes is not None:
            return min(self.pixels, int(settings.densify.most * self.expected_gaussians()))
        return self.pixels

    def steered(
        self,
        quantum: float,
        times: Times,
        at: float,
        file_bytes: int,
        reached: Callable[[], float],
        lost: Callable[[], float],
    ) -> float:
        """The quantum from this time on, given that of now and what it comes to: the file's size, how much of aim_db it
        has, and the PSNR that rounding takes, both in dB and asked for where they are needed."""
        s, limit = self.settings.rate, self.settings.rate.steering_limit
        if not self.is_steered or (self.max_bytes is None and self.aim_db is None):
            # That asked for; finer early, where a size or a PSNR would have steered it to.
            return self.quantum / float(times.finer_early ** _surplus(times, at))
        if at < times.steering_from or (self.by_looks and at not in times.looks_at):
            return quantum
        exponent = s.steering_exponent if at in times.growth_at else s.trim_exponent
        ratio: float
        if self.max_bytes is not None:
            # The whole size and more from the first: the fine steps that this means serve Gaussians well while they
            # are few. Later there are more Gaussians than can stay, and those that gain least for their bits go.
            ratio = (file_bytes / (self.max_bytes * _excess(times, at))) ** exponent
        else:
            assert self.aim_db is not None
            # Early in the growth a larger error than the final one is right.
            missing = max(1 - (at - times.steering_from) / (times.early_until - times.steering_from), 0)
            above = reached() - self.aim_db
            if self.by_looks:
                limit = s.looks_limit
                above += s.looks_refined_db if self.settings.effort.refine_sweeps else 0
            ratio = 2 ** ((above + times.early_db * missing) / s.db_per_doubling * exponent)
            # Where rounding takes next to nothing, a finer quantum cannot give what is missing.
            if ratio < 1 and at > times.growth_at[-1] and lost() < min(s.missed_db, -above):
                return quantum
        return quantum if ratio == 1.0 else quantum * min(max(ratio, 1 / limit), limit)

    def finer(self, quantum: float, reached: float) -> float:
        """The quantum that a further round begins with, where files have reached this much of aim_db and no more."""
        s = self.settings.rate
        return quantum * max(2 ** ((reached - (self.aim_db or reached)) / s.db_per_doubling), 1 / s.looks_limit)

    @property
    def further_rounds(self) -> int:
        """Beyond those of the effort, while what is asked for is missed."""
        s = self.settings.schedule
        return 0 if self.aim_db is None else s.rounds_for_looks if self.by_looks else s.rounds_for_psnr

    @property
    def tries(self) -> int:
        """Files with different quanta, at most, where something is to be reached."""
        return self.settings.rate.looks_tries if self.by_looks else self.settings.rate.aim_tries

    def allows(self, psnr: Callable[[], float]) -> bool:
        """Whether Gaussians may be dropped that leave this PSNR: none would come back once growth is over."""
        return self.aim_db is None or self.by_looks or psnr() >= self.aim_db - self.settings.prune.missed_db

    def reached(self, coded: Coded) -> float:
        """Of a coded picture, what aim_db asks for."""
        return coded.looks_db if self.by_looks else coded.psnr


@dataclass(frozen=True)
class Selection:
    """How files of one budget are searched and compared."""

    rate: RateControl

    def payload_limit(self, empty: StreamV2) -> int:
        """Bytes that the budget leaves for the payload, beside what a file without any takes."""
        return NO_LIMIT if self.rate.max_bytes is None else max(self.rate.max_bytes - empty.file_bytes, 0)

    def affords(self, texture: Codes) -> bool:
        """Whether a texture's bytes are a small part of the budget."""
        return len(pack(texture)) <= self.rate.settings.objective.texture.share * (self.rate.max_bytes or math.inf)

    def first_quantum(self, quantum: float, payload: Callable[[float], int], limit: int) -> float:
        """The quantum to try first, given that of the fit and the bytes to which Gaussians come: for a size the finest
        at which all of them fit, by bisection. Even the coarsest may leave too much; then refining drops some."""
        if not self.rate.is_steered or self.rate.max_gaussians is not None:
            return self.rate.quantum
        if self.rate.max_bytes is None:
            return quantum if self.rate.aim_db is not None else self.rate.quantum
        low, high = math.log(0.8 * quantum), math.log(1.02 * quantum)
        while payload(math.exp(high)) > limit and high < math.log(MAX_QUANTUM):
            low, high = high, high + math.log(2)
        while payload(math.exp(low)) < limit and low > math.log(MIN_QUANTUM):
            low, high = low - math.log(2), low
        for _ in range(8):
            middle = (low + high) / 2
            low, high = (low, middle) if payload(math.exp(middle)) <= limit else (middle, high)
        return math.exp(high)

    def next_quantum(self, tried: Sequence[Coded], limit: int, size_tries: int) -> float | None:
        """The quantum to try after those tried; None where nothing is to be gained."""
        last = tried[-1]
        if self.rate.aim_db is not None:
            found = self._nearer(tried) if len(tried) < self.rate.tries else None
            known = {quantum_code(one.stream.quantum) for one in tried}
            return None if found is None or quantum_code(found) in known else found
        if not self.rate.is_steered or self.rate.max_bytes is None or len(tried) > size_tries:
            return None
        used = last.size / max(limit, 1)  # refining makes files smaller, by a percent or, after a short fit, a fifth
        if used >= self.rate.settings.rate.least_used or used == 0:
            return None
        return last.stream.quantum * float(used**self.rate.settings.rate.quantum_per_size)

    def is_cut_short(self, size: int, limit: int) -> bool:
        """Whether a fit that comes to this payload was cut short, and so is also worth coding with fewer Gaussians."""
        return (
            self.rate.is_steered
            and self.rate.max_bytes is not None
            and size > self.rate.settings.rate.far_from_size * limit
        )

    def spared(self, coded: Coded) -> int:
        """Bytes with which a coded picture, once it is relaxed, has about what was asked for, if anything was."""
        s = self.rate.settings.refine
        above = -1.0 if self.rate.aim_db is None else self.rate.reached(coded) - self.rate.aim_db
        if above < 0:
            return NO_LIMIT
        return int(coded.size * (1 - s.relaxed_gain - min(s.size_per_db * above, s.most_spared)))

    def is_missed(self, found: Iterable[Coded]) -> bool:
        """Whether a PSNR, or looks, were asked for, and none of the files has them. Less than a point of looks is not
        worth another round."""
        if self.rate.aim_db is None:
            return False
        slack = self.rate.settings.rate.slack_db if self.rate.by_looks else 0.0
        return max(map(self.rate.reached, found)) < self.rate.aim_db - slack

    def best(self, found: Iterable[Coded], aim: float | None = None) -> Coded:
        """The one that meets the budget best. aim: an aim_db that is out of reach is replaced by this."""
        first, *others = found
        return max([first, *others], key=lambda one: self.merit(one, aim)) if others else first

    def merit(self, coded: Coded, aim: float | None = None) -> tuple[float, float]:
        """By which files of one budget are compared; the second where the first is equal."""
        if self.rate.aim_db is not None:
            return min(self.rate.reached(coded), self.rate.aim_db if aim is None else aim), -coded.size
        if self.rate.max_bytes is not None or self.rate.max_gaussians is not None:
            return -coded.error, -coded.size
        return -coded.error - 8 * error_per_bit(self.rate.quantum) * coded.size, -coded.size

    def reachable(self, tried: Sequence[Coded]) -> float | None:
        """What to aim at, in dB: the best so far, or a PSNR a little below it, where a finer quantum hardly helps any
        more."""
        s, reached = self.rate.settings.rate, self.rate.reached
        if self.rate.aim_db is None or len(tried) < 2:
            return self.rate.aim_db
        best = max(map(reached, tried))
        if best >= self.rate.aim_db:
            return self.rate.aim_db
        finest, finer = sorted(tried, key=lambda one: one.stream.quantum)[:2]
        octaves = math.log2(finer.stream.quantum / finest.stream.quantum)
        if reached(finest) - reached(finer) >= s.least_gain * s.db_per_doubling * octaves:
            return self.rate.aim_db
        return best if self.rate.by_looks else best - s.missed_db

    def _nearer(self, tried: Sequence[Coded]) -> float | None:
        """Where the line through the two tries nearest to what is asked for meets it, or a little above."""
        s, aim = self.rate.settings.rate, self.reachable(tried)
        assert aim is not None
        above = [self.rate.reached(one) - aim for one in tried]
        if 0 <= above[-1] <= s.slack_db:
            return None
        slope = -s.db_per_doubling
        points = ((math.log2(one.stream.quantum), y) for one, y in zip(tried, above, strict=True))
        (x, y), *others = sorted(points, key=lambda point: abs(point[1]))
        if others and others[0][0] != x:
            x1, y1 = others[0]
            slope = min(max((y1 - y) / (x1 - x), 2 * slope), slope / 4)
        # Near the aim chance decides, so each near miss asks for a little more.
        near_misses = sum(-s.slack_db < y < 0 for y in above)
        at = x + (0.4 * (1 + near_misses) * s.slack_db - y) / slope
        return float(2 ** min(max(at, math.log2(MIN_QUANTUM)), math.log2(MAX_QUANTUM)))


def of_alpha(rate: RateControl) -> RateControl:
    """For the alpha plane, which goes first. Under a budget of bytes it takes what it is worth, up to a limit."""
    s = rate.settings.alpha
    quantum = min(s.coarser * rate.quantum, MAX_QUANTUM)
    if rate.max_gaussians is not None:
        return replace(rate, quantum=quantum, max_gaussians=max(int(s.most_gaussians * rate.max_gaussians), 1))
    if rate.max_bytes is None:
        return replace(rate, quantum=quantum, aim_db=None)
    most = int(s.most_bytes * (rate.max_bytes - SMALLEST_FILE - SMALLEST_ALPHA))
    return replace(rate, quantum=quantum, max_bytes=StreamV2.MIN_BYTES + most, is_steered=False)


def beside_alpha(rate: RateControl, alpha: StreamV2, error: float) -> RateControl:
    """For the colours beside an alpha plane; error: the mean squared one of the file, if only alpha were wrong."""
    if rate.max_gaussians is not None:
        used = len(alpha.gaussians()) if alpha.payload else 0
        return replace(rate, max_gaussians=max(rate.max_gaussians - used, 1))
    if rate.max_bytes is not None:
        return rate.for_bytes(rate.max_bytes - alpha_bytes(alpha))
    if rate.aim_db is None or rate.by_looks:
        return rate
    allowed = 10 ** (-rate.aim_db / 10)
    return replace(rate, aim_db=min(-10 * math.log10(max(allowed - error, allowed / 4)), MAX_PSNR_DB))


def allows_alpha(rate: RateControl, error: float) -> bool:
    """Whether alpha alone makes no more than its share of the error that a PSNR allows."""
    if rate.aim_db is None or rate.by_looks:
        return True
    return error <= rate.settings.alpha.most_error * 10 ** (-rate.aim_db / 10)


def missed_db(rate: RateControl, reached: float) -> float:
    """By how much a file that reaches this, as aim_db is counted, misses it; 0 where it does not."""
    return 0.0 if rate.aim_db is None else max(rate.aim_db - reached, 0.0)


def raised(rate: RateControl, by_db: float) -> RateControl:
    """The same with an aim that is higher by this, and a little more."""
    if rate.aim_db is None:
        return rate
    return replace(rate, aim_db=min(rate.aim_db + by_db + rate.settings.rate.slack_db / 2, MAX_PSNR_DB))


def _surplus(times: Times, at: float) -> float:
    """1 while there may be more than was asked for, falling to 0."""
    return 1 - min(max((at - times.excess_from) / (times.excess_until - times.excess_from), 0), 1)


def _excess(times: Times, at: float) -> float:
    """The allowance, in multiples of the Gaussians or bytes asked for."""
    return 1 + times.excess * _surplus(times, at)
