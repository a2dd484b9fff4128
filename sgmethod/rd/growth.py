"""Where another Gaussian would pay: matching pursuit on the residual at a few scales (profile rd).

Let e be the residual and w a round Gaussian of scale s at some place. Its best colour is <w, e> / <w, w>. That takes
its gain, <w, e>^2 / <w, w>, off the squared error.

The Gaussians of profile rd end at sigma = 3. Such a Gaussian is as wide as a whole one of scale b = 0.849 s. Its
integral is 0.801 2 pi s^2, its energy <w, w> is 0.412 2 pi s^2. With g the residual blurred by a normalised Gaussian
of scale b, the gain is therefore 4.33 pi b^2 |g|^2: one blur gives the gain at every place.

A place qualifies where its gain is the largest within the Gaussian's own size, and is more than its bits are worth.

All is done in bands of rows, several at once: no array but the residual on a smaller picture, for wide blurs, is as
large as the picture.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from numpy.typing import NDArray

from sgmethod.native import native
from sgmethod.scene import FloatArray

BLURS_PX = (0.75, 1.5, 3.0, 6.0, 12.0, 24.0, 48.0)
SCALE_OF_BLUR = 1 / 0.84868  # s / b
GAIN = 4.327 * math.pi
BAND = 256  # rows; an even number
REACH = 4  # of a blur, in multiples of it; what cv2 takes

Rows = Callable[[int, int], FloatArray]  # of a residual, from the first to before another: [3, rows, W]


def candidates(residual: Rows, size: tuple[int, int], most: int, least_gain: float) -> tuple[FloatArray, FloatArray]:
    """Means [N, 2] and factors [N, 3] of at most `most` round Gaussians for a residual of size (height, width), each
    with a gain above least_gain, best first."""
    # The gain of a wider one counts what lies outside, and hides every other place.
    blurs = [b for b in BLURS_PX if REACH * b <= max(size)] or [BLURS_PX[0]]
    bands = [(first, min(first + BAND, size[0])) for first in range(0, size[0], BAND)]
    half = np.empty((3, -(-size[0] // 2), -(-size[1] // 2)), np.float32)

    def halve(band: tuple[int, int]) -> None:
        first, end = band
        for plane, to in zip(residual(first, end), half[:, first // 2 : -(-end // 2)], strict=True):
            to[...] = _halved(plane)

    with ThreadPoolExecutor(native.thread_count()) as pool:
        list(pool.map(halve, bands))
        gains = _Gains(residual, size, blurs, half)
        found = list(pool.map(lambda band: gains.peaks(band[0], band[1], least_gain), bands))
    gain, rows, columns, chosen = (np.concatenate(parts) for parts in zip(*found, strict=True))
    order = np.argsort(-gain, kind="stable")[: max(most, 0)]
    means = np.stack([columns[order], rows[order]], 1).astype(np.float32) + 0.5
    scale = np.array(blurs, np.float32)[chosen[order]] * np.float32(SCALE_OF_BLUR)
    return means, np.stack([scale, 0 * scale, scale], 1)


class _Gains:
    """The gain of the best blur at every place."""

    def __init__(self, residual: Rows, size: tuple[int, int], blurs: list[float], half: FloatArray) -> None:
        """half: the residual at half the size."""
        self.residual, (self.height, self.width), self.blurs = residual, size, blurs
        self.widest = max(1, int(blurs[-1]))
        self.shrinks = [_shrink(b, min(size)) for b in blurs]
        # Gains of wide blurs, on smaller pictures: there the same blur takes a fraction of the time.
        self.small: dict[int, FloatArray] = {}
        planes, shrink = list(half), 2
        for index, b in enumerate(blurs):
            while shrink < self.shrinks[index]:
                planes, shrink = [_halved(plane) for plane in planes], 2 * shrink
            if self.shrinks[index] > 1:
                self.small[index] = _gain(planes, b / shrink, b)

    def peaks(
        self, first: int, end: int, least: float
    ) -> tuple[FloatArray, NDArray[np.intp], NDArray[np.intp], NDArray[np.uint8]]:
        """Gain, row, column and index of the blur where the gain is above the least, and the largest within the
        blur's own size. In rows from `first` to before `end`."""
        top, bottom = max(first - self.widest, 0), min(end + self.widest, self.height)
        gain, chosen = self._rows(top, bottom)
        above = gain[first - top : end - top] > least
        peaks = np.zeros(above.shape, np.bool_)
        largest, reach = gain, 0  # within so many pixels
        for index, b in enumerate(self.blurs):
            wider = max(1, int(b))
            if wider > reach:  # windows of windows: a wide one at once takes its width in time
                side = 2 * (wider - reach) + 1
                largest = np.asarray(cv2.dilate(largest, np.ones((side, side), np.uint8)), np.float32)
                reach = wider
            peaks |= ((gain >= largest) & (chosen == index))[first - top : end - top]
        rows, columns = np.nonzero(peaks & above)
        rows += first - top
        return gain[rows, columns], rows + top, columns, chosen[rows, columns]

    def _rows(self, first: int, end: int) -> tuple[FloatArray, NDArray[np.uint8]]:
        """Rows from `first` to before `end` of the gain, and of the index of the blur that has it."""
        gain = np.zeros((end - first, self.width), np.float32)
        chosen = np.zeros(gain.shape, np.uint8)
        reach = math.ceil(REACH * max(b for b, shrink in zip(self.blurs, self.shrinks, strict=True) if shrink == 1)) + 1
        top, bottom = max(first - reach, 0), min(end + reach, self.height)
        planes = self.residual(top, bottom)
        for index, b in enumerate(self.blurs):
            if index in self.small:
                found = self._enlarged(index, first, end)
            else:
                found = _gain(list(planes), b, b)[first - top : end - top]
            # Indices rise, so that the larger one is that of the larger gain.
            np.maximum(chosen, (found > gain).view(np.uint8) * np.uint8(index), out=chosen)
            np.maximum(gain, found, out=gain)
        return gain, chosen

    def _enlarged(self, index: int, first: int, end: int) -> FloatArray:
        """Rows from `first` to before `end` of a gain from a smaller picture."""
        small, shrink = self.small[index], self.shrinks[index]
        top = max(first // shrink - 1, 0)
        part = small[top : end // shrink + 2]
        size = (part.shape[1] * shrink, part.shape[0] * shrink)
        enlarged = cv2.resize(part, size, interpolation=cv2.INTER_LINEAR)
        return np.asarray(enlarged[first - top * shrink : end - top * shrink, : self.width], np.float32)


def _gain(planes: list[FloatArray], sigma: float, blur: float) -> FloatArray:
    """Of round Gaussians everywhere. sigma: of the blur in pixels of these planes, blur: in those of the picture."""
    total = np.zeros(planes[0].shape, np.float32)
    for plane in planes:
        cv2.accumulateSquare(cv2.GaussianBlur(plane, (0, 0), sigma, borderType=cv2.BORDER_REFLECT), total)
    total *= GAIN * blur * blur
    return total


def _shrink(blur: float, shorter_side: int) -> int:
    """How many times smaller a picture may be that is blurred so much."""
    shrink = 1 << max(0, int(math.log2(blur / 3)) if blur > 3 else 0)
    while shrink > 1 and shorter_side < 4 * shrink:
        shrink //= 2
    return shrink


def _halved(plane: FloatArray) -> FloatArray:
    """At half the size; at an odd end the last sample counts twice."""
    height, width = plane.shape
    if height % 2 or width % 2:
        plane = np.pad(plane, ((0, height % 2), (0, width % 2)), mode="edge")
    size = (plane.shape[1] // 2, plane.shape[0] // 2)
    return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_AREA), np.float32)
