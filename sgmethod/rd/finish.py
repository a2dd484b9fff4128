"""From fitted Gaussians to the coded picture that meets the budget best.

The search for the quantum tries several. Each try quantises all Gaussians with one quantum, and then refines the
integers of each on the picture that the others leave (sgmethod/native/refine/refine.cpp).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sgmethod.bitstream import container
from sgmethod.bitstream.payload import HEADER_BYTES, MAX_QUANTUM, MIN_QUANTUM
from sgmethod.bitstream.texture import Codes, pack
from sgmethod.bitstream.v4 import StreamV4
from sgmethod.decoder import draw_whole
from sgmethod.fitting import eye
from sgmethod.fitting.parameters import Parameters
from sgmethod.fitting.request import Request
from sgmethod.metrics import psnr
from sgmethod.rd import growth, quantiser
from sgmethod.rd.fit import RdFit, relaxed
from sgmethod.rd.quantiser import Coder
from sgmethod.rd.texture import estimate

NO_LIMIT = 1 << 40
EXACT_DB = 99.0  # of a picture without any error
UNUSED, BYTES_OF_ONE = 0.03, 8  # of a size, and of one Gaussian: files end below their size by so much without harm
FILLED_DB = 0.3  # that further Gaussians gain at least, or the quantum has to be finer
LEAST_KEPT = 0.9  # of a file's bytes, where single Gaussians are taken away to come down to a PSNR
RELAXED_S = 2.0  # seconds, at most, to relax and refine, for each of refining alone
MOST_SPARED = 0.05  # of a file that is above the PSNR asked for, by relaxing it once
QUANTA = 6  # of the grid are as far apart as two prices
ROUNDED_DB = 58.9  # of one that differs from its source as much as rounding to 8 bits does

# The better of a stream, and of what a coder and a price of a bit make of the same Gaussians.
Better = Callable[[StreamV4, Coder, float], StreamV4]


@dataclass(frozen=True)
class Found:
    """A coded picture, and the search that found it."""

    stream: StreamV4
    finish: Finish


class Finish:
    """The search for the quantum of one encode, once its Gaussians are fitted."""

    def __init__(self, fit: RdFit, request: Request, relaxings: int = 0) -> None:
        """relaxings: times, at most, that its file is relaxed."""
        self.relaxings, self.refined_s = relaxings, 0.0  # seconds that refining took, the last time
        self.p, self.coder, self.picture = fit.p.copy(), fit.coder, fit.picture
        self.control, self.settings = fit.control, fit.settings
        self.source, self.alpha = request.pixels, request.alpha
        self.clock, self.request = request.recorder.clock, request

    def stream(self) -> StreamV4:
        """The coded picture that meets the budget best."""
        texture = self._texture(self.p)
        limit = self._limit(texture)
        if self.control.psnr is not None:
            best = self._at_psnr(self.control.psnr)
        elif self.control.max_bytes is not None:
            best = self._within(limit)
        else:
            best = self._quantise_and_refine(self.coder.with_quantum(self.control.quantum))
        best = self._relaxed(best, limit)
        # What rounding to 8 bits takes away was perhaps all there was: a flat picture is its background.
        background = self.coder.stream(Parameters.empty(0))
        enough = min(self.psnr(best), self.control.psnr or math.inf)
        return replace(background if self.psnr(background) >= enough else best, texture=texture)

    def found(self) -> Found:
        """The same, with the search that found it."""
        return Found(self.stream(), self)

    def best(self, found: Sequence[Found]) -> Found:
        """The one that meets the budget best, of several that were found in the course of one encode."""
        return max(found, key=lambda one: self._merit(one.stream)) if len(found) > 1 else found[0]

    def searched(self, found: Sequence[Found], is_stiff: bool) -> StreamV4:
        """What a further search finds near the best: the smallest that reaches the PSNR, or what is best within the
        size, and uses it. found: by one encode; is_stiff: whether by way of the ladder.

        It is for a stiff picture; and for a PSNR where the file is far above it, or tiny: then a byte is worth tenths
        of a decibel, and where refining ends is chance.
        """
        s, chosen = self.settings, self.best(found)
        best = chosen.stream
        is_tiny = len(best.payload) <= s.tiny_bytes
        is_worth_it = is_stiff and len(best.payload) <= s.searched_bytes
        if self.control.psnr is not None:
            db, aim = self.psnr(best), self.control.psnr
            if is_worth_it or is_tiny or db > aim + s.psnr_slack_db:
                for one in self._few(found, chosen, is_tiny):
                    best = one.finish._smallest(best, min(db, aim), one.stream.quantum, is_tiny)
        elif self.control.max_bytes is not None and is_stiff:
            limit = self._limit(best.texture)
            if is_worth_it:
                for one in self._few(found, chosen, is_tiny):
                    best = one.finish._best_within(best, limit, one.stream.quantum, is_tiny)
            best = self._filled(best, limit)
        return best

    def _few(self, found: Sequence[Found], best: Found, is_tiny: bool) -> Sequence[Found]:
        """Those whose Gaussians are searched with: of a tiny file the best few, of others the best."""
        if not is_tiny:
            return [best]
        return sorted(found, key=lambda one: self._merit(one.stream), reverse=True)[: self.settings.searched_fits]

    def has_enough(self, stream: StreamV4) -> bool:
        """Whether it has what the budget asks for, bytes or a PSNR, or is as good as 8 bits allow."""
        most = self.control.max_bytes
        if most is not None and len(container.serialise(stream)) >= min((1 - UNUSED) * most, most - BYTES_OF_ONE):
            return True
        return not self.control.has_goal or self.psnr(stream) >= min(self.control.psnr or ROUNDED_DB, ROUNDED_DB)

    def _merit(self, stream: StreamV4) -> tuple[float, float]:
        """By which streams of one budget are compared, whatever its kind; the second where the first is equal."""
        size = len(stream.payload)
        if self.control.psnr is not None:
            return min(self.psnr(stream), self.control.psnr), -size
        if self.control.max_bytes is not None or self.control.max_gaussians is not None:
            return self._quality(stream), -size
        price = quantiser.error_per_bit(self.control.quantum)
        return -self.error(stream) - 8 * price * size, -size

    def background(self) -> StreamV4:
        """The coded picture without any Gaussian."""
        nothing = Parameters.empty(0)
        return replace(self.coder.with_quantum(self.control.quantum).stream(nothing), texture=self._texture(nothing))

    def _texture(self, p: Parameters) -> Codes | None:
        """That goes with Gaussians as they would be rounded now; the quantum found later differs little."""
        if self.settings.tune == "psnr":
            return None
        drawn = draw_whole(self.coder.stream(p))
        if self.alpha is not None:  # nobody sees what was left there
            drawn = np.where(self.alpha[..., None] > 0, drawn, self.source)
        codes = estimate(self.source, drawn, self.settings)
        most = self.settings.texture_share * (self.control.max_bytes or math.inf)
        return codes if codes is not None and len(pack(codes)) <= most else None

    def _limit(self, texture: Codes | None) -> int:
        """Bytes that the budget leaves for the payload, beside a texture."""
        if self.control.max_bytes is None:
            return NO_LIMIT
        return self.control.max_bytes - HEADER_BYTES - (0 if texture is None else len(pack(texture)))

    def _left_s(self) -> float:
        return max(self.request.left_s(), 0.0)

    def _quantise_and_refine(self, coder: Coder, max_payload: int = NO_LIMIT, dearer: float = 1.0) -> StreamV4:
        return self._refined(self.p, coder, max_payload, dearer)

    def _refined(self, p: Parameters, coder: Coder, max_payload: int, dearer: float) -> StreamV4:
        price = dearer * self.settings.refine_weight * quantiser.error_per_bit(coder.quantum)
        limits = price, self.settings.refine_sweeps, self._left_s(), max_payload
        began = self.clock.seconds()
        refined = coder.refined(p, self.picture.target, *limits, self.picture.visibility)
        self.refined_s = self.clock.seconds() - began
        return refined

    def _relaxed(self, stream: StreamV4, limit: int) -> StreamV4:
        """The stream, or a better one with a payload of at most `limit` bytes.

        Refining finds no change of one Gaussian that helps. So half of them, drawn by lot, move to what rounding the
        others has left, and all are refined again; then another half.
        """
        if not self.relaxings:
            return stream
        coder, merit = self.coder.with_quantum(stream.quantum), self._merit(stream)
        lot = np.random.default_rng(self.request.seed)
        for _ in range(self.relaxings):
            if not stream.payload or self._left_s() <= RELAXED_S * self.refined_s:
                break
            p = Parameters.of(stream.gaussians())
            p = relaxed(self.picture, p, lot.random(len(p.means)) < 0.5, stream.quantum, self.settings)
            found = self._refined(p, coder, min(limit, self._spared(stream)), 1.0)
            stream, merit = max((stream, merit), (found, self._merit(found)), key=lambda one: one[1])
        return stream

    def _spared(self, stream: StreamV4) -> int:
        """Bytes with which the stream, once it is relaxed, has about the PSNR that was asked for, if any was."""
        s = self.settings
        above = -1.0 if self.control.psnr is None else self.psnr(stream) - self.control.psnr
        if above < 0:
            return NO_LIMIT
        return int(len(stream.payload) * (1 - s.relaxed_gain - min(s.size_per_db * above, MOST_SPARED)))

    def psnr(self, stream: StreamV4) -> float:
        """Of a coded picture, in dB, as far as alpha shows it; without texture, which is there to be seen and not to be
        measured."""
        decoded, shown = draw_whole(stream, texture=False), self.picture.shown
        if shown is None:
            return min(psnr(decoded, self.source), EXACT_DB)
        mse = eye.error(shown, decoded, self.source) / (255**2 * self.source.size)
        return -10 * math.log10(max(mse, 10 ** (-EXACT_DB / 10)))

    def _quality(self, stream: StreamV4) -> float:
        """By which streams of about one size are compared: PSNR, or less of the error that the eye sees."""
        return self.psnr(stream) if self.picture.visibility is None else -self.error(stream)

    def error(self, stream: StreamV4) -> float:
        """Squared, summed over the picture, white being 1; as the eye sees it, where the file is tuned for it."""
        if self.picture.visibility is None:
            return self.source.size * float(10 ** (-self.psnr(stream) / 10))
        return eye.error(self.picture.visibility, draw_whole(stream, texture=False), self.source) / 255**2

    def _within(self, limit: int) -> StreamV4:
        """The best with a payload of at most `limit` bytes.

        The first try is the finest quantum at which all Gaussians fit. If refining leaves bytes unused, finer ones
        follow. A fit that was cut short can be far from its size: then the quantum as it is, with fewer Gaussians, is
        tried too, if there is time.
        """
        s, coder = self.settings, self._coder_within(limit)
        found = [self._quantise_and_refine(coder, limit)]
        # Refining makes files smaller, by a percent or, where the fit was short, a fifth.
        for _ in range(s.size_tries):
            used = len(found[-1].payload) / max(limit, 1)
            if used >= s.least_used or used == 0 or self._left_s() == 0:
                break
            coder = coder.with_quantum(coder.quantum * used**s.quantum_per_size)
            found.append(self._quantise_and_refine(coder, limit))
        if self._left_s() > 0 and len(self.coder.stream(self.p).payload) > s.far_from_size * limit:
            found.append(self._quantise_and_refine(self.coder, limit))
        return max(found, key=self._quality) if len(found) > 1 else found[0]

    def _coder_within(self, limit: int) -> Coder:
        """The finest quantum at which all Gaussians fit, by bisection.

        Even the coarsest may leave too much. Then refining drops Gaussians.
        """
        low, high = math.log(0.8 * self.coder.quantum), math.log(1.02 * self.coder.quantum)
        while self._payload(high) > limit and high < math.log(MAX_QUANTUM):
            low, high = high, high + math.log(2)
        while self._payload(low) < limit and low > math.log(MIN_QUANTUM):
            low, high = low - math.log(2), low
        for _ in range(8):
            middle = (low + high) / 2
            low, high = (low, middle) if self._payload(middle) <= limit else (middle, high)
        return self.coder.with_quantum(math.exp(high))

    def _payload(self, log_quantum: float) -> int:
        return len(self.coder.with_quantum(math.exp(log_quantum)).stream(self.p).payload)

    def _at_psnr(self, psnr_db: float) -> StreamV4:
        """The smallest found that reaches the PSNR; where none does, the smallest about as good as the best."""
        slack = self.settings.psnr_slack_db
        tried: dict[float, float] = {}  # log2 of the quantum: decibels
        at, streams, aim, took = math.log2(self.coder.quantum), {}, psnr_db, 0.0
        for _ in range(self.settings.psnr_tries):
            began = self.clock.seconds()
            streams[at] = self._quantise_and_refine(self.coder.with_quantum(2**at))
            tried[at] = self.psnr(streams[at])
            took = self.clock.seconds() - began
            aim = self._reachable(aim, tried)
            if 0 <= tried[at] - aim <= slack or took > self._left_s():
                break
            at = self._next_quantum({quantum: db - aim for quantum, db in tried.items()})
            if at in tried:
                break
        reached = [q for q, db in tried.items() if db >= aim]
        if not reached:
            return streams[max(tried, key=lambda q: tried[q])]
        at = min(reached, key=lambda q: len(streams[q].payload))
        return streams[at]

    def _reachable(self, aim: float, tried: dict[float, float]) -> float:
        """The PSNR to aim at: a little less than the best so far where a finer quantum hardly helps any more."""
        if len(tried) < 2 or max(tried.values()) >= aim:
            return aim
        (finest, db), (finer, before) = sorted(tried.items())[:2]
        if db - before >= self.settings.least_gain * self.settings.db_per_doubling * (finer - finest):
            return aim
        return max(tried.values()) - self.settings.missed_db

    def _smallest(self, best: StreamV4, psnr_db: float, quantum: float, is_tiny: bool) -> StreamV4:
        """The smallest of many with these Gaussians that reach the PSNR, if it is smaller than the best so far. At the
        end a limit on the bytes, by bisection, takes single Gaussians away."""

        def within(limit: int, best: StreamV4, coder: Coder, dearer: float) -> StreamV4:
            found = self._quantise_and_refine(coder, limit, dearer)
            return found if self.psnr(found) >= psnr_db else best

        def smaller(best: StreamV4, coder: Coder, dearer: float) -> StreamV4:
            return within(len(best.payload) - 1, best, coder, dearer)

        best = self._near(best, quantum, is_tiny, smaller)
        too_small, enough = int(LEAST_KEPT * len(best.payload)), psnr_db + self.settings.psnr_slack_db
        while len(best.payload) - too_small > 1 and self.psnr(best) > enough and self._left_s() > 0:
            limit = (too_small + len(best.payload)) // 2
            found = within(limit, best, self.coder.with_quantum(best.quantum), 1.0)
            best, too_small = (best, limit) if found is best else (found, too_small)
        return best

    def _best_within(self, best: StreamV4, limit: int, quantum: float, is_tiny: bool) -> StreamV4:
        """The best of many with these Gaussians and payloads of at most `limit` bytes, if it is better than the best so
        far."""

        def better(best: StreamV4, coder: Coder, dearer: float) -> StreamV4:
            found = replace(self._quantise_and_refine(coder, limit, dearer), texture=best.texture)
            return max(best, found, key=self._quality)

        return self._near(best, quantum, is_tiny, better)

    def _near(self, best: StreamV4, quantum: float, is_tiny: bool, better: Better) -> StreamV4:
        """The best of a grid of quanta, from the one given on, and prices of a bit; then, for a small picture, of ever
        nearer ones. Of a file that is not tiny the grid's prices are tried with the best quantum alone."""
        s, at = self.settings, (quantum, 1.0)

        def tries() -> Iterator[tuple[float, float]]:
            for finer in s.searched_quanta:
                for dearer in s.searched_prices if is_tiny else (1.0,):
                    yield quantum * finer, dearer
            for dearer in () if is_tiny else s.searched_prices:
                yield at[0], dearer
            for octaves in s.searched_nearer if self.control.pixels <= s.ladder_pixels else ():
                for finer, cheaper in itertools.product((-octaves, 0.0, octaves), repeat=2):
                    yield at[0] * 2**finer, at[1] * 2 ** (QUANTA * cheaper)

        for tried in tries():
            if not best.payload or self._left_s() == 0:
                break
            before, best = best, better(best, self.coder.with_quantum(tried[0]), tried[1])
            at = at if best is before else tried
        return best

    def _filled(self, stream: StreamV4, limit: int) -> StreamV4:
        """The stream with more Gaussians where it leaves the largest errors, for the bytes that it leaves. A fit can
        end without a use for them: the fine quantum that they allow is no help to Gaussians that are too few."""
        s, picture, quantum = self.settings, self.picture, stream.quantum
        for _ in range(s.fillings):
            if self.has_enough(stream) or self._left_s() == 0:
                break
            p = Parameters.of(stream.gaussians())
            n = len(p.means)
            room = min(math.ceil((limit - len(stream.payload)) * n / len(stream.payload)), self.control.pixels - n)
            least_gain = s.bits_of_new * s.refine_weight * quantiser.error_per_bit(quantum)
            p = p.with_more(growth.new_gaussians(picture, p, room, least_gain, s.color_solve_steps))
            more = replace(self._refined(p, self.coder.with_quantum(quantum), limit, 1.0), texture=stream.texture)
            gained = self.psnr(more) - self.psnr(stream)
            stream = max(stream, more, key=self._quality)
            if gained < FILLED_DB:
                quantum /= math.sqrt(2)
        return stream

    def _next_quantum(self, tried: dict[float, float]) -> float:
        """Where the line through the two tries nearest to the target meets it, or a little above."""
        slope = -self.settings.db_per_doubling
        (x, y), *others = sorted(tried.items(), key=lambda item: abs(item[1]))
        if others:
            (x1, y1) = others[0]
            slope = min(max((y1 - y) / (x1 - x), 2 * slope), slope / 4) if x1 != x else slope
        at = x + (0.4 * self.settings.psnr_slack_db - y) / slope
        return min(max(at, math.log2(MIN_QUANTUM)), math.log2(MAX_QUANTUM))
