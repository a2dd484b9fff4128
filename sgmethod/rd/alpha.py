"""Alpha: a grey picture of its own in the file. It is coded first; then colours count as far as it shows them.

An error e of a colour under alpha a is a e on any background, so it weighs a^2: what nobody sees costs nothing. An
error d of alpha is d times the colour less the background. A file's error is the mean over a white and a black one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sgmethod.bitstream import container
from sgmethod.bitstream.payload import HEADER_BYTES
from sgmethod.bitstream.v4 import ALPHA_HEADER, StreamV4
from sgmethod.budget import MAX_PSNR_DB, Budget
from sgmethod.decoder import draw_whole
from sgmethod.errors import BudgetError
from sgmethod.fitting.recorder import Recorder
from sgmethod.fitting.request import Request
from sgmethod.io.laying import on_backgrounds
from sgmethod.metrics import psnr
from sgmethod.profiles import EFFORTS, RdSettings
from sgmethod.rd.rate_control import SMALLEST_FILE, RateControl, psnr_of_quantum
from sgmethod.trace import shown_to_nobody

Pixels = NDArray[np.uint8]
Plane = NDArray[np.float32]
Encode = Callable[[Request, RdSettings], tuple[StreamV4, int]]  # the file's stream, and the steps it took

SMALLEST = SMALLEST_FILE + ALPHA_HEADER.size
FEWEST_BYTES, PIXELS_PER_BYTE = 48, 500  # of the first alpha that is tried for an error
MOST_BYTES = 0.6  # of a budget, for alpha, while colours may need the rest
LEFT_OVER = 0.1  # of a budget of bytes, beyond which what colours have left goes to alpha
SHARES = (0.3, 0.1, 0.03)  # of the error that a budget lets expect, at most by alpha; the first that serves
NEARLY_DB = 0.5  # a PSNR is missed by so little that better colours may mend it
AIMS = 4  # at a PSNR
GUESSED_BYTES = 0.2  # of a budget, for alpha, while it is not known
GUESSED_EFFORT = 2  # of colours, while their error is not known: 1 is too far from what follows
# Errors go with about these powers of the bytes' inverse, those of colours and of alpha.
ERROR_PER_BYTES, ALPHA_ERROR_PER_BYTES = 1.0, 1.5
MOST_TRIES = 5
NEAR, MOST_FACTOR = 1.15, 16.0  # between the sizes of two tries
NEAR_ERROR, NEARLY_ALL = 0.5, 0.75  # of an error asked for, and of bytes, that are as good as all
MOST_GAUSSIANS = 0.25  # of a budget of Gaussians
OVERSHOOT = 0.4
OF_TIME, FIRST_OF_TIME = 0.3, 0.5  # of a time limit, for all alpha that is tried, and for the first


@dataclass(frozen=True)
class _Tried:
    """Alpha that was coded, and the file's error if nothing but alpha were wrong."""

    stream: StreamV4
    error: float

    @property
    def size(self) -> int:
        """Bytes, at least 1."""
        return max(len(self.stream.payload), 1)


def encode(request: Request, settings: RdSettings, encode_layer: Encode) -> tuple[StreamV4, int]:
    """The stream of a request with alpha, and the steps it took. encode_layer: for a request without.

    Raises BudgetError for a budget no file can meet.
    """
    return _Layers(request, settings, encode_layer).encode()


class _Layers:
    """One encode: alpha, then colours."""

    def __init__(self, request: Request, settings: RdSettings, encode_layer: Encode) -> None:
        assert request.alpha is not None
        self.request, self.settings, self.encode_layer = request, settings, encode_layer
        self.source, self.steps = request.alpha, 0
        self.within: dict[int, _Tried] = {}
        self.quick: StreamV4 | None = None  # a whole picture, made early to see what errors cost
        self.quick_s = 0.0
        self.pixels = continued(request.pixels, self.source)
        height, width = self.source.shape
        self.max_bytes = request.budget.max_bytes(width, height)
        if self.max_bytes is not None and self.max_bytes < SMALLEST:
            raise BudgetError(f"a file with alpha takes at least {SMALLEST} bytes, the budget is {self.max_bytes}")

    def encode(self) -> tuple[StreamV4, int]:
        """As above."""
        if self.request.budget.kind == "psnr":
            return self._at_psnr(self.request.budget.value), self.steps
        alpha = self._alpha()
        stream = self._colours(alpha, self.settings)
        if self.quick is not None and self.request.left_s() < self.quick_s:  # time may have been short
            stream = min(stream, self.quick, key=lambda one: self._error_of(draw_whole(one)))
        if self.max_bytes is not None:
            stream = self._with_left_over(stream, self.max_bytes)
        return stream, self.steps

    def _with_left_over(self, stream: StreamV4, max_bytes: int) -> StreamV4:
        """What colours leave of the bytes goes to alpha, if there is much, and alpha is better then."""
        alpha, left = stream.alpha, max_bytes - len(container.serialise(stream))
        if alpha is None or left <= LEFT_OVER * max_bytes or (error := self._error_by(alpha)) == 0:
            return stream
        more = self._layer(Budget("bytes", HEADER_BYTES + len(alpha.payload) + left), 1.0)
        return replace(stream, alpha=more) if self._error_by(more) < error else stream

    def _alpha(self) -> StreamV4:
        budget = self.request.budget
        if budget.kind == "gaussians":
            return self._layer(Budget("gaussians", max(int(MOST_GAUSSIANS * self.request.gaussians_asked()), 1)))
        if self.max_bytes is not None:
            return self._of_bytes(self.max_bytes - SMALLEST)
        quantum = RateControl.of(self.request, self.settings).quantum
        return self._of_error(SHARES[0] * _mse(psnr_of_quantum(quantum)))

    def _error_by(self, alpha: StreamV4) -> float:
        """The file's, if nothing but alpha were wrong."""
        return self._error_of(np.dstack([self.pixels, draw_whole(alpha)[..., 0]]))

    def _at_psnr(self, psnr_db: float) -> StreamV4:
        """Colours do not know all of an error: what alpha adds to theirs, and that both are rounded. So they are asked
        for more, or alpha is, where the PSNR is missed."""
        shares, aim, found = list(SHARES), psnr_db, []
        alpha = self._of_error(shares.pop(0) * _mse(psnr_db))
        for _ in range(AIMS):
            stream = self._colours(alpha, self.settings, aim)
            missed = psnr_db + 10 * math.log10(max(self._error_of(draw_whole(stream)), _mse(MAX_PSNR_DB)))
            found.append((missed, stream))
            if missed <= 0 or self._is_late():
                break
            if missed <= NEARLY_DB:
                aim += missed + self.settings.psnr_slack_db / 2
            elif shares:
                alpha = self._of_error(shares.pop(0) * _mse(psnr_db))
            else:
                break
        return min(found, key=lambda one: one[0])[1]

    def _of_error(self, most: float) -> StreamV4:
        """About the smallest that makes no more error."""
        tried: list[_Tried] = []
        size = max(FEWEST_BYTES, self.source.size // PIXELS_PER_BYTE)
        while not _is_near(size, tried) and len(tried) < MOST_TRIES and not (tried and self._is_late()):
            tried.append(self._within(size))
            if NEAR_ERROR * most <= tried[-1].error <= most or tried[-1].size < NEARLY_ALL * size:
                break  # or a larger one would be as this one is
            factor = (tried[-1].error / (math.sqrt(NEAR_ERROR) * most)) ** (1 / _exponent(tried))
            size = max(round(size * min(max(factor, 1 / MOST_FACTOR), MOST_FACTOR)), FEWEST_BYTES)
        enough = [one for one in tried if one.error <= most]
        return (min(enough, key=lambda one: one.size) if enough else min(tried, key=lambda one: one.error)).stream

    def _of_bytes(self, most: int) -> StreamV4:
        """The one with which colours in the rest of so many bytes make the least error, in all."""
        tried = [self._within(int(GUESSED_BYTES * most))]
        clock = self.request.recorder.clock
        began = clock.seconds()
        colours = self._colours(tried[0].stream, replace(self.settings, **EFFORTS[GUESSED_EFFORT]))
        self.quick, self.quick_s = colours, clock.seconds() - began
        error = self._error_of(np.dstack([draw_whole(colours)[..., :3], self.source]))
        guess, largest = tried[0].size, max(MOST_BYTES * most, 1.0)
        sizes = np.geomspace(min(FEWEST_BYTES, largest), largest, 64)

        def in_all(size: float, alpha: _Tried) -> float:
            """The error with so many bytes for alpha, by one that was tried."""
            theirs = error * (max(most - guess, 1) / max(most - size, 1)) ** ERROR_PER_BYTES
            return float(alpha.error * (size / alpha.size) ** -_exponent(tried) + theirs)

        while tried[0].error > 0 and len(tried) < MOST_TRIES and not self._is_late():
            best = min(sizes, key=lambda size: in_all(size, _nearest(size, tried)))
            if _is_near(best, tried):
                break
            tried.append(self._within(round(best)))
        return min(tried, key=lambda one: in_all(one.size, one)).stream

    def _is_late(self) -> bool:
        return replace(self.request, part=OF_TIME).left_s() < 0

    def _within(self, size: int) -> _Tried:
        """The best with a payload of at most so many bytes, fitted once."""
        if size not in self.within:
            stream = self._layer(Budget("bytes", HEADER_BYTES + size), OF_TIME if self.within else FIRST_OF_TIME)
            self.within[size] = _Tried(stream, self._error_by(stream))
        return self.within[size]

    def _layer(self, budget: Budget, part: float = FIRST_OF_TIME) -> StreamV4:
        """Alpha, coded in a part of the time."""
        grey = np.repeat(self.source[..., None], 3, axis=2)
        recorder = Recorder(self.request.recorder.clock, None)
        layer = replace(self.request, pixels=grey, alpha=None, budget=budget, recorder=recorder, part=part)
        settings = replace(
            self.settings, tune="psnr", overshoot=OVERSHOOT, with_shear=True, rounds=(0,), ladder_pixels=0
        )
        stream, steps = self.encode_layer(layer, settings)
        self.steps += steps
        return stream

    def _colours(self, alpha: StreamV4, settings: RdSettings, psnr_db: float = 0.0) -> StreamV4:
        """With their alpha. psnr_db: to aim at in place of the budget's, where that is one."""
        shown, budget = draw_whole(alpha)[..., 0], self.request.budget
        if self.max_bytes is not None:
            budget = Budget("bytes", self.max_bytes - ALPHA_HEADER.size - len(alpha.payload))
        elif budget.kind == "gaussians":
            used = len(alpha.gaussians()) if alpha.payload else 0
            budget = Budget("gaussians", max(self.request.gaussians_asked() - used, 1))
        elif budget.kind == "psnr":
            left = _mse(psnr_db) - self._error_by(alpha)
            budget = Budget("psnr", min(-10 * math.log10(max(left, _mse(psnr_db) / 4)), MAX_PSNR_DB))
        recorder = self.request.recorder
        preview = recorder.preview
        if preview is not shown_to_nobody:
            recorder = recorder.previewing(lambda file: preview(_with_alpha(file, alpha)))
        part = replace(self.request, pixels=self.pixels, alpha=shown, budget=budget, recorder=recorder)
        stream, steps = self.encode_layer(part, settings)
        self.steps += steps
        return replace(stream, alpha=alpha)

    def _error_of(self, decoded: Pixels) -> float:
        """The mean squared error of decoded pixels [H, W, 4]."""
        return _mse(psnr(on_backgrounds(decoded), on_backgrounds(np.dstack([self.pixels, self.source]))))


def _exponent(tried: Sequence[_Tried]) -> float:
    """Of the bytes' inverse with which the error goes, by the last two."""
    if len(tried) < 2 or tried[-1].size == tried[-2].size:
        return ALPHA_ERROR_PER_BYTES
    last, before = tried[-1], tried[-2]
    found = math.log(max(before.error, 1e-12) / max(last.error, 1e-12)) / math.log(last.size / before.size)
    return min(max(found, 1.0), 2 * ALPHA_ERROR_PER_BYTES)


def _nearest(size: float, tried: Sequence[_Tried]) -> _Tried:
    return min(tried, key=lambda one: abs(math.log(size / one.size)))


def _is_near(size: float, tried: Sequence[_Tried]) -> bool:
    return any(1 / NEAR < size / one.size < NEAR for one in tried)


def continued(pixels: Pixels, alpha: Pixels) -> Pixels:
    """Pixels [H, W, 3] in which those that alpha [H, W] hides are as those around them: whatever a file has there is
    nobody's picture. Means over ever larger squares of what is seen fill the gaps."""
    if alpha.all():
        return pixels
    share = np.asarray(alpha, np.float32) / np.float32(255)
    levels: list[tuple[Plane, Plane]] = [(pixels * share[..., None], share)]
    while max(alpha.shape) > 1 << (len(levels) - 1):
        levels.append((_halved(levels[-1][0]), _halved(levels[-1][1])))
    colours, weight = levels[-1]
    filled: NDArray[Any] = colours / np.maximum(weight, 1e-6)[..., None]
    for colours, weight in reversed(levels[:-1]):
        height, width = weight.shape
        coarse = cv2.resize(filled, (width, height), interpolation=cv2.INTER_LINEAR).reshape(height, width, 3)
        known = weight[..., None]
        filled = coarse * (1 - known) + colours
    return np.where(alpha[..., None] > 0, pixels, np.rint(np.clip(filled, 0, 255)).astype(np.uint8))


def _halved(plane: Plane) -> Plane:
    height, width = plane.shape[:2]
    size = max(-(-width // 2), 1), max(-(-height // 2), 1)
    return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_AREA), np.float32)


def _mse(psnr_db: float) -> float:
    return float(10 ** (-psnr_db / 10))


def _with_alpha(file: bytes, alpha: StreamV4) -> bytes:
    stream = container.parse(file)
    assert isinstance(stream, StreamV4)
    return container.serialise(replace(stream, alpha=alpha))
