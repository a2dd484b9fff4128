"""Matching pursuit: find the places where another Gaussian pays, from the residual at a few scales.

Let e be the residual and w a round Gaussian of scale s at some place. Its best colour is <w, e> / <w, w>, which lowers
the squared error by its gain, <w, e>^2 / <w, w>.

The Gaussians of profile rd end at sigma = 3. Such a Gaussian is as wide as a Gaussian of scale b = 0.849 s that is not
cut off. Its integral is 0.801 2 pi s^2, its energy <w, w> is 0.412 2 pi s^2. With g the residual blurred by a
normalised Gaussian of scale b, the gain is therefore 4.33 pi b^2 |g|^2: one blur gives the gain at every place.

A place qualifies if its gain is the largest of all scales within the Gaussian's own size, and exceeds the worth of its
bits. Wide blurs are computed and searched on smaller pictures. Each size of the picture therefore needs two maps from
the others: the largest gain at coarser sizes, enlarged, and the largest of each four samples at finer ones.

Early in the fit, wide gains are everywhere and hide nearly all others: growth would find ten places for hundreds of
Gaussians. So a setting limits the number of coarser sizes that can hide a place.

If a side is odd, the last coarse sample reaches beyond the picture, where the residual counts as zero. If the last
pixels were repeated instead, a bright or dark frame would promise impossible gains there, and hide all other places.

The full size of a large picture is processed in bands of rows, to save memory.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.planes import even, halved
from sgmethod.fitting.bands import Rows, bands
from sgmethod.opencv import cv2
from sgmethod.scene import FloatArray
from sgmethod.threads import in_parallel

BLURS_PX = (0.42, 0.75, 1.5, 3.0, 6.0, 12.0, 24.0, 48.0)  # the first fits a single pixel
SCALE_OF_BLUR = 1 / 0.84868  # s / b
GAIN = 4.327 * math.pi
REACH = 4  # radius of a blur's kernel in cv2, in multiples of its scale


class Places(NamedTuple):
    """Arrays [N] for N Gaussians: gain, centre in pixels, and blur."""

    gain: FloatArray
    x: FloatArray
    y: FloatArray
    blur: FloatArray


def candidates(
    residual: Rows, size: tuple[int, int], most: int, least_gain: float, hidden_by: int
) -> tuple[FloatArray, FloatArray]:
    """Find round Gaussians that reduce a residual of size (height, width), best first.

    Returns means [N, 2] and factors [N, 3] of at most `most` Gaussians, each with a gain above least_gain. hidden_by:
    coarser sizes that can hide a place, at least 1.
    """
    found = _places(residual, size, least_gain, hidden_by)
    gain, x, y, blur = (np.concatenate(values) for values in zip(*found, strict=True))
    order = np.argsort(-gain, kind="stable")[: max(most, 0)]
    scale = blur[order] * np.float32(SCALE_OF_BLUR)
    inside = np.array([size[1], size[0]], np.float32) - 0.5
    means = np.clip(np.stack([x[order], y[order]], 1), 0.5, inside).astype(np.float32)
    return means, np.stack([scale, 0 * scale, scale], 1)


def _places(residual: Rows, size: tuple[int, int], least_gain: float, hidden_by: int) -> list[Places]:
    height, width = size
    # Wider blurs would count the mirrored outside as gain, and hide all other places.
    blurs = [b for b in BLURS_PX if REACH * b <= max(size)] or [BLURS_PX[0]]
    by_shrink: dict[int, list[float]] = {}
    for b in blurs:
        by_shrink.setdefault(_shrink(b, min(size)), []).append(b)
    narrow = by_shrink.pop(1)
    parts = bands(height, width)
    if len(parts) == 1:
        residual = _drawn_once(residual, height)
    half_size = -(-height // 2), -(-width // 2)
    margin = math.ceil(REACH * narrow[-1]) + _reach(narrow[-1], 1)
    half, seen = np.empty((3, *half_size), np.float32), np.zeros(half_size, np.float32)

    levels: list[_Level] = []
    if by_shrink:
        for first, end in parts:
            for plane, to in zip(residual(first, end), half[:, first // 2 : -(-end // 2)], strict=True):
                to[...] = halved(plane, "constant")
        levels = _coarse_levels(list(half), by_shrink)
    hiding = levels[-1].most(hidden_by - 1) if levels else None
    found = []
    for first, end in parts:
        top, bottom = max(first - margin, 0), min(end + margin, height)
        level = _Level(list(residual(top, bottom)), 1, narrow)
        most = level.gain if hiding is None else np.maximum(level.gain, _enlarged(hiding, top, bottom, width))
        here = slice(first - top, end - top)
        _most_of_four(most[here], out=seen[first // 2 : -(-end // 2)])
        found.append(level.places(most, least_gain, here, top))
    for level in reversed(levels):  # finest first
        seen = np.maximum(seen, level.most(hidden_by))
        found.append(level.places(seen, least_gain))
        seen = _most_of_four(seen)
    return found


def _drawn_once(residual: Rows, height: int) -> Rows:
    """Compute a residual once, because its rows are requested twice."""
    whole = residual(0, height)
    return lambda first, end: whole[:, first:end]


class _Level:
    """Gains at one size of the picture."""

    def __init__(
        self, planes: list[FloatArray], shrink: int, blurs: list[float], coarser: _Level | None = None
    ) -> None:
        """Compute gains. planes [3]: the residual; blurs: in pixels of the full size; coarser: the next level."""
        self.shrink, self.blurs, self.coarser = shrink, blurs, coarser
        self.depth: int = 0 if coarser is None else coarser.depth + 1  # number of coarser levels
        self._most: dict[int, FloatArray] = {}
        # The widest blur takes longest, and so comes first.
        *wider, self.gain = in_parallel(lambda b: _gain(planes, b / shrink, b), blurs[::-1])
        self.chosen = np.zeros(self.gain.shape, np.uint8)  # index of the blur with the largest gain
        for index, more in enumerate(reversed(wider), 1):
            # Indices rise, so the maximum keeps the last blur that exceeded all before it.
            np.maximum(self.chosen, (more > self.gain).view(np.uint8) * np.uint8(index), out=self.chosen)
            np.maximum(self.gain, more, out=self.gain)

    def most(self, coarser: int) -> FloatArray:
        """Largest gain on this level and the next `coarser` ones."""
        coarser = min(coarser, self.depth)
        if self.coarser is None or coarser == 0:
            return self.gain
        if coarser not in self._most:
            height, width = self.gain.shape
            self._most[coarser] = np.maximum(self.gain, _enlarged(self.coarser.most(coarser - 1), 0, height, width))
        return self._most[coarser]

    def places(self, everywhere: FloatArray, least: float, rows: slice = slice(None), first_row: int = 0) -> Places:
        """Places in some rows of the level with a gain above `least` that is the largest within their blur's size.

        everywhere: the largest gain at all levels; first_row: the picture's row at which this level's rows begin.
        """
        peaks = np.zeros(self.gain[rows].shape, np.bool_)
        largest, reach = everywhere, 0  # the maximum within `reach` samples
        for index, b in enumerate(self.blurs):
            wider = _reach(b, self.shrink)
            if wider > reach:  # extend the window step by step: the time of one dilation is proportional to its width
                side = 2 * (wider - reach) + 1
                largest = np.asarray(cv2.dilate(largest, np.ones((side, side), np.uint8)), np.float32)
                reach = wider
            peaks |= (self.gain[rows] >= largest[rows]) & (self.chosen[rows] == index)
        y, x = np.nonzero(peaks & (self.gain[rows] > least))
        y += rows.start or 0
        gain, blurs = self.gain[y, x], np.array(self.blurs, np.float32)[self.chosen[y, x]]
        x_px, y_px = ((place + np.float32(0.5)) * np.float32(self.shrink) for place in self._peak(x, y))
        return Places(gain, x_px, y_px + np.float32(first_row), blurs)

    def _peak(self, x: NDArray[np.intp], y: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        """Refine peaks, in samples, to the maxima of the parabolas through each sample and its neighbours."""
        height, width = self.gain.shape
        here = self.gain[y, x]
        left, right = self.gain[y, np.maximum(x - 1, 0)], self.gain[y, np.minimum(x + 1, width - 1)]
        above, below = self.gain[np.maximum(y - 1, 0), x], self.gain[np.minimum(y + 1, height - 1), x]

        def beside(before: FloatArray, after: FloatArray) -> FloatArray:
            bend = np.maximum(2 * here - before - after, 1e-30)
            return np.asarray(np.clip((after - before) / (2 * bend), -0.5, 0.5), np.float32)

        return x + beside(left, right), y + beside(above, below)


def _coarse_levels(half: list[FloatArray], blurs: dict[int, list[float]]) -> list[_Level]:
    """Build a level for each shrink, coarsest first. half: the residual's planes at half the size."""
    planes = {2: half}
    for shrink in list(blurs)[1:]:
        planes[shrink] = [halved(plane, "constant") for plane in planes[shrink // 2]]
    levels: list[_Level] = []
    for shrink, here in reversed(blurs.items()):
        levels.append(_Level(planes[shrink], shrink, here, levels[-1] if levels else None))
    return levels


def _enlarged(plane: FloatArray, first: int, end: int, width: int) -> FloatArray:
    """Enlarge a plane to twice the size; return its rows from `first` to before `end`."""
    top = max(first // 2 - 1, 0)
    part = plane[top : end // 2 + 2]
    large = cv2.resize(part, (part.shape[1] * 2, part.shape[0] * 2), interpolation=cv2.INTER_LINEAR)
    return np.asarray(large[first - 2 * top : end - 2 * top, :width], np.float32)


def _gain(planes: list[FloatArray], sigma: float, blur: float) -> FloatArray:
    """Gain of a round Gaussian at each sample. sigma, blur: the same scale, in samples and in pixels of the picture."""
    total = np.zeros(planes[0].shape, np.float32)
    for plane in planes:
        cv2.accumulateSquare(cv2.GaussianBlur(plane, (0, 0), sigma, borderType=cv2.BORDER_REFLECT_101), total)
    total *= GAIN * blur * blur
    return total


def _shrink(blur: float, shorter_side: int) -> int:
    """Factor by which a picture may be reduced for this blur."""
    shrink = 1 << max(0, int(math.log2(blur / 1.5)))
    while shrink > 1 and shorter_side < 4 * shrink:
        shrink //= 2
    return shrink


def _reach(blur: float, shrink: int) -> int:
    """Radius in samples within which a blur's gain has to be the largest."""
    return max(1, int(blur / shrink))


def _most_of_four(plane: FloatArray, out: FloatArray | None = None) -> FloatArray:
    """Reduce a plane to half the size, by the largest of each four samples."""
    plane = even(plane)
    rows = np.maximum(plane[0::2], plane[1::2])
    return np.maximum(rows[:, 0::2], rows[:, 1::2], out=out)
