"""Search: quantise and refine a fit with several quanta, and keep the best file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.protocol import COARSE_SIDE, Moments, RefineLimits, Target, release_memory
from sgmethod.bitstream.texture import Codes, pack
from sgmethod.bitstream.v2 import StreamV2, coded_background, is_upright
from sgmethod.fitting.bands import Rows
from sgmethod.fitting.deadline import Deadline
from sgmethod.fitting.moving_target import FitTarget, led
from sgmethod.fitting.recorder import Recorder
from sgmethod.rd.fit import descent_on
from sgmethod.rd.levels import MANY_VALUES, Levels
from sgmethod.rd.rate_control import Coded, RateControl, error_per_bit
from sgmethod.rd.state import Aim, State
from sgmethod.scene import Gaussians

TEXTURE_CODINGS = 3.0  # those of a search that has no time, and one for the texture
FEW_BYTES = 32  # of payload: their Gaussians may gain less than the mean colour alone
ROUNDING_LEVELS = 2  # spread of a picture whose background may miss no more than rounding to 8 bits does
TEXTURE_SHARE = 0.05  # most of a budget of bytes
MAX_TRIES = 7  # quanta
WEIGHT = 0.35  # price of a bit, in multiples of its theoretical price
# Once for each round after the first, half of the Gaussians are refitted to what the rounded other half leaves, and all
# are refined again.
RELAXED_STEPS, RELAXED_RATE = 20, 0.15
RELAXED_WEIGHT = 0.6  # price of a bit in these steps, in multiples of its theoretical price
# Where a file is exact already, smaller ones are tried: with these shares of the Gaussians, after some steps of this
# rate, on at most so many pixels in all; and with a quantum that is coarser by these factors. Seen for any budget that
# suffices: a dot on a plain picture takes 47 to 56 bytes instead of 56 to 105, a step of one level 29 to 40 instead of
# 114 to 372.
EXACT_SHARES = (0.7, 0.9)
EXACT_STEPS, EXACT_RATE = 100, 0.4
EXACT_PIXELS = 1 << 20
EXACT_COARSER = (2**0.5, 2**0.25)
EXACT_TRIES = 40  # limit on files with a coarser quantum; it shrinks as a picture grows beyond EXACT_PIXELS


@dataclass(frozen=True)
class Search:
    """A search for the file of a fit: it codes with several quanta. rounds: those completed."""

    levels: Levels
    rate: RateControl
    deadline: Deadline
    recorder: Recorder
    state: State
    rounds: int

    @cached_property
    def aim(self) -> Aim:
        """What this search aims at."""
        levels, state = self.levels, self.state
        error = cache(partial(levels.error, state.gaussians, state.quantum))
        return state.aim or Aim(refining_target(levels, state), error)

    def file(self) -> Coded:
        """Return the file that meets the budget best.

        For each round after the first, a random half of the Gaussians is fitted again, to make up for the rounding of
        the other half. Then all are refined again: refining alone finds no single change that helps.
        """
        problem, rate, deadline, state = self.levels.problem, self.rate, self.deadline, self.state
        coded = cache(partial(problem.stream, state.gaussians))  # several quanta have one code

        def payload(quantum: float) -> int:
            return len(coded(StreamV2.coded_quantum(quantum, problem.is_short)).payload)

        self._report(0, rate.usual_tries)
        texture = self._texture(lambda: coded(state.quantum))
        if self.levels.finest.values > MANY_VALUES:
            release_memory()  # which the fit kept for its next step
        empty = replace(problem.stream(Gaussians.empty(0), state.quantum), texture=texture)
        limit, refined = max(rate.max_bytes - empty.file_bytes, 0), partial(self._refined, texture)
        code = partial(refined, state.gaussians, max_bytes=limit)
        first = rate.first_quantum(state.quantum, payload, limit, deadline.attempts)
        tried = self._tried(first, limit, code)
        if deadline.left_s() > 0 and rate.is_cut_short(payload(state.quantum), limit):
            tried.append(code(state.quantum))
        best = exact = rate.chosen(tried)
        if state.is_enough:  # the fit itself may be too large for the budget, and small enough below
            exact = rate.best([best, Coded(coded(state.quantum), problem.objective)])
        if rate.is_enough(exact) and (exact := self._smaller(exact)).size <= limit:
            best, tries = exact, 0
        else:
            tries = max(self.rounds - 1, 0) if best.size else 0
        rng = np.random.default_rng(0)
        for number in deadline.attempts(tries):
            self._report(number, tries)
            held = rng.random(len(best.stream.gaussians())) < 0.5
            again = relaxed(self.levels, best.stream, self.aim.target, held, [RELAXED_RATE] * RELAXED_STEPS)
            best = rate.best([best, refined(again, best.stream.quantum, min(limit, rate.relaxed_bytes(best)))])
        return self._or_mean(best, empty)

    def _tried(self, first: float, limit: int, code: Callable[[float], Coded]) -> list[Coded]:
        """Code a fit with one quantum after the other, as rate control chooses them, until nothing is to be gained."""
        rate, tried = self.rate, list[Coded]()
        quantum: float | None = first
        for _ in self.deadline.attempts(MAX_TRIES):
            if quantum is None:
                break
            tried.append(code(quantum))
            self._report(len(tried), max(rate.usual_tries, len(tried) + 1))
            quantum = rate.next_quantum(tried, limit, self.levels.effort.size_tries)
        return tried

    def _texture(self, coded: Callable[[], StreamV2]) -> Codes | None:
        """Return the texture of a fit, if there is time to find it and it takes a small part of the budget."""
        if not self.deadline.has_time_for_codings(TEXTURE_CODINGS):
            return None
        texture = self.levels.problem.objective.texture(coded())
        return texture if texture is not None and len(pack(texture)) <= TEXTURE_SHARE * self.rate.max_bytes else None

    def _or_mean(self, best: Coded, empty: StreamV2) -> Coded:
        """Return the mean colour alone if that is better than a file of few bytes, or of a nearly flat picture."""
        problem, histogram = self.levels.problem, self.levels.problem.objective.histogram
        if best.size > FEW_BYTES and histogram.spread > ROUNDING_LEVELS:
            return best
        mean = coded_background(histogram.mean, problem.is_short)
        empty = replace(empty, quantum=best.stream.quantum, texture=None, background=mean)
        return self.rate.best([best, Coded(empty, problem.objective)])

    def _report(self, step: int, steps: int) -> None:
        """Report the progress, unless another run of the schedule follows."""
        if self.rounds >= self.levels.effort.rounds[-1]:
            state = self.state
            self.recorder.report("search", step, steps, self.aim.error, len(state.gaussians), state.size)

    def _refined(self, texture: Codes | None, gaussians: Gaussians, quantum: float, max_bytes: int) -> Coded:
        """Code Gaussians with this quantum in at most max_bytes of payload, beside a texture.

        Their integers are refined one Gaussian at a time on the target that the others leave (native/refine/).
        """
        problem, finest = self.levels.problem, self.levels.finest
        quantum = StreamV2.coded_quantum(quantum, problem.is_short)
        coding = replace(problem.coding(quantum), upright=is_upright(gaussians.factors, problem.with_shear))
        spacing = finest.frame.spacing
        price = WEIGHT * error_per_bit(quantum) / spacing**2
        limits = RefineLimits(price, self.levels.effort.refine_sweeps, self.deadline.left_s(), max_bytes, spacing)
        payload = finest.backend.refine(gaussians, coding, self.aim.target, limits, finest.visibility)
        colours = *problem.size, quantum, problem.background, problem.grey, coding.upright, payload
        return Coded(StreamV2(*colours, texture, is_short=coding.is_short), problem.objective)

    def _smaller(self, exact: Coded) -> Coded:
        """Search for a smaller file of an exact picture, with fewer Gaussians or a coarser quantum."""
        problem, target, attempts = self.levels.problem, self.aim.target, self.deadline.attempts
        exact, last = Coded(replace(exact.stream, texture=None), problem.objective), None

        def fewer(share: float) -> Coded:
            stream, gaussians = exact.stream, exact.stream.gaussians()
            strongest = np.argsort(-problem.objective.energies(gaussians), kind="stable")
            few = gaussians.rows(np.sort(strongest[: int(share * len(strongest))]))
            held = np.zeros(len(few), bool)
            moved = relaxed(self.levels, problem.stream(few, stream.quantum), target, held, [EXACT_RATE] * EXACT_STEPS)
            return self._refined(None, moved, stream.quantum, exact.size)

        def coarser(by: float) -> Coded:
            return self._refined(None, exact.stream.gaussians(), exact.stream.quantum * by, exact.size)

        pixels = problem.pixels.size // 3
        slow = attempts(EXACT_PIXELS // pixels)
        quick = attempts(min(EXACT_TRIES, EXACT_TRIES * EXACT_PIXELS // pixels))
        ways = [(partial(fewer, share), slow) for share in EXACT_SHARES]
        ways += [(partial(coarser, by), quick) for by in EXACT_COARSER]
        while last is not exact:
            last = exact
            for way, turns in ways:
                for _ in turns:
                    found = way()
                    if found.error > 0 or found.size >= exact.size:
                        break
                    exact = found
        return exact


def relaxed(
    levels: Levels, stream: StreamV2, target: Target, held: NDArray[np.bool_], rates: Sequence[float]
) -> Gaussians:
    """Take steps of these rates with the Gaussians [N] of a coded picture, except those that are held [N]."""
    level = replace(levels.finest, target=target)
    before = stream.gaussians()
    moving, moments = before.copy(), Moments.none(len(before))
    price = RELAXED_WEIGHT * error_per_bit(stream.quantum)
    descent = descent_on(levels, level, stream.quantum, price)
    for rate in rates:
        levels.finest.backend.steps(moving, moments, descent, [rate])
        for values, held_at in zip(moving.arrays, before.arrays, strict=True):
            values[held] = held_at[held]
    return moving


def at_rest(levels: Levels, state: State) -> tuple[Levels, State]:
    """Return both for a search that no run follows: of all pictures, they keep the target of refining alone."""
    error = levels.error(state.gaussians, state.quantum)  # by the picture, which goes
    target = refining_target(levels, state, into=state.target.now)
    finest = replace(levels.finest, target=target)
    pyramid = replace(levels.pyramid, levels=(finest,), detailed=(finest,))
    state = replace(state, target=FitTarget(target, target), aim=Aim(target, lambda: error))
    return replace(levels, pyramid=pyramid), state


def refining_target(levels: Levels, state: State, into: Target | None = None) -> Target:
    """Return the target of refining, which weighs each pixel alone: coarse errors move it, into memory if given."""
    objective, finest = levels.problem.objective, levels.finest
    shrink, level = COARSE_SIDE // (2 * finest.frame.spacing), objective.with_coarse(finest)
    if shrink == 0 or level.visibility is None or level.visibility.coarse == 0:
        return state.target.now
    error = level.missing(state.gaussians, half=True)
    if objective.shown is not None:
        error = _where(level.visibility.half.values > 0, error)
    return led(state.target.now, error, level.visibility.coarse, shrink, into)


def _where(shown: NDArray[np.bool_], error: Rows) -> Rows:
    """Leave out the error of samples that alpha hides. shown: [H, W] at half the size, as the error's planes."""
    return lambda first, end: error(first, end) * shown[first // 2 : -(-end // 2)]
