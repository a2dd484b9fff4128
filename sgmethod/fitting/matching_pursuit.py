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

The full size of a large picture is processed in bands of rows, to save memory, and each band in strips, one for each
thread.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.planes import even, gains, halved
from sgmethod.fitting.bands import Rows, bands, parallel_rows
from sgmethod.opencv import cv2
from sgmethod.scene import FloatArray

BLURS_PX = (0.42, 0.75, 1.5, 3.0, 6.0, 12.0, 24.0, 48.0)  # the first fits a single pixel
SCALE_OF_BLUR = 1 / 0.84868  # s / b
GAIN = 4.327 * math.pi
REACH = 4  # radius of a blur's kernel, in multiples of its scale


class Places(NamedTuple):
    """Arrays [N] for N Gaussians: gain, centre in pixels, and blur."""

    gain: FloatArray
    x: FloatArray
    y: FloatArray
    blur: FloatArray


def candidates(
    residual: Rows, size: tuple[int, int], limit: int, min_gain: float, suppression_levels: int
) -> tuple[FloatArray, FloatArray]:
    """Find round Gaussians that reduce a residual of size (height, width), best first.

    Returns means [N, 2] and factors [N, 3] of at most `limit` Gaussians, each with a gain above min_gain.
    suppression_levels: coarser sizes that can hide a place, at least 1.
    """
    found = _places(residual, size, min_gain, suppression_levels)
    gain, x, y, blur = (np.concatenate(values) for values in zip(*found, strict=True))
    order = np.argsort(-gain, kind="stable")[: max(limit, 0)]
    scale = blur[order] * np.float32(SCALE_OF_BLUR)
    inside = np.array([size[1], size[0]], np.float32) - 0.5
    means = np.clip(np.stack([x[order], y[order]], 1), 0.5, inside).astype(np.float32)
    return means, np.stack([scale, 0 * scale, scale], 1)


def _places(residual: Rows, size: tuple[int, int], min_gain: float, suppression_levels: int) -> list[Places]:
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
    levels = _coarse_levels(residual, parts, half_size, by_shrink)
    hiding = levels[-1].largest(suppression_levels - 1) if levels else None
    found, finer = [], np.zeros(half_size, np.float32)
    for first, end in parts:
        top, bottom = max(first - margin, 0), min(end + margin, height)
        level = _GainLevel(list(residual(top, bottom)), 1, narrow)
        largest = level.gain if hiding is None else _larger(level.gain, hiding, top)
        here = slice(first - top, end - top)
        _max_of_four(largest[here], out=finer[first // 2 : -(-end // 2)])
        found.append(level.places(largest, min_gain, here, top))
    for level in reversed(levels):  # finest first
        np.maximum(finer, level.largest(suppression_levels), out=finer)
        found.append(level.places(finer, min_gain))
        finer = _max_of_four(finer)
    return found


def _drawn_once(residual: Rows, height: int) -> Rows:
    """Compute a residual once, because its rows are requested twice."""
    whole = residual(0, height)
    return lambda first, end: whole[:, first:end]


class _GainLevel:
    """Gains at one size of the picture."""

    def __init__(
        self, planes: list[FloatArray], shrink: int, blurs: list[float], coarser: _GainLevel | None = None
    ) -> None:
        """Compute gains. planes [3]: the residual; blurs: in pixels of the full size; coarser: the next level."""
        self.shrink, self.blurs, self.coarser = shrink, blurs, coarser
        self.depth: int = 0 if coarser is None else coarser.depth + 1  # number of coarser levels
        self._largest: dict[int, FloatArray] = {}
        sigmas = np.array(blurs, np.float32)
        # The gains, and the index of the blur that each is of.
        self.gain, self.chosen = gains(planes, sigmas / np.float32(shrink), np.float32(GAIN) * sigmas**2)

    def largest(self, coarser: int) -> FloatArray:
        """Largest gain on this level and the next `coarser` ones."""
        coarser = min(coarser, self.depth)
        if self.coarser is None or coarser == 0:
            return self.gain
        if coarser not in self._largest:
            self._largest[coarser] = _larger(self.gain, self.coarser.largest(coarser - 1), 0)
        return self._largest[coarser]

    def places(self, everywhere: FloatArray, least: float, rows: slice = slice(None), first_row: int = 0) -> Places:
        """Places in some rows of the level with a gain above `least` that is the largest within their blur's size.

        everywhere: the largest gain at all levels; first_row: the picture's row at which this level's rows begin.
        """
        begin, stop, _ = rows.indices(len(self.gain))
        margin = _reach(self.blurs[-1], self.shrink)

        def strip(first: int, end: int) -> tuple[NDArray[np.intp], ...]:
            first, end = begin + first, begin + end
            top, bottom = max(first - margin, 0), min(end + margin, len(self.gain))
            gain, chosen = self.gain[first:end], self.chosen[first:end]
            peaks = np.zeros(gain.shape, np.bool_)
            largest, reach = everywhere[top:bottom], 0  # the maximum within `reach` samples
            for index, b in enumerate(self.blurs):
                wider = _reach(b, self.shrink)
                if wider > reach:  # extend the window step by step: a dilation's time is proportional to its width
                    side = 2 * (wider - reach) + 1
                    largest = np.asarray(cv2.dilate(largest, np.ones((side, side), np.uint8)), np.float32)
                    reach = wider
                peaks |= (gain >= largest[first - top : end - top]) & (chosen == index)
            y, x = np.nonzero(peaks & (gain > least))
            return y + first, x

        y, x = (np.concatenate(found) for found in zip(*parallel_rows(strip, stop - begin), strict=True))
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


def _coarse_levels(
    residual: Rows, parts: list[tuple[int, int]], half_size: tuple[int, int], blurs: dict[int, list[float]]
) -> list[_GainLevel]:
    """Build a level for each shrink, coarsest first. parts: bands of the residual."""
    if not blurs:
        return []
    half = np.empty((3, *half_size), np.float32)
    for first, end in parts:
        _halve(residual(first, end), half[:, first // 2 : -(-end // 2)])
    planes = {2: list(half)}
    for shrink in list(blurs)[1:]:
        height, width = planes[shrink // 2][0].shape
        planes[shrink] = list(_halve(planes[shrink // 2], np.empty((3, -(-height // 2), -(-width // 2)), np.float32)))
    levels: list[_GainLevel] = []
    for shrink, here in reversed(blurs.items()):
        levels.append(_GainLevel(planes[shrink], shrink, here, levels[-1] if levels else None))
    return levels


def _halve(planes: Iterable[FloatArray], out: FloatArray) -> FloatArray:
    """Reduce planes to half the size, into `out`."""

    def strip(first: int, end: int) -> None:
        for plane, to in zip(planes, out, strict=True):
            to[first:end] = halved(plane[2 * first : 2 * end], "constant")

    parallel_rows(strip, out.shape[1])
    return out


def _larger(gain: FloatArray, coarse: FloatArray, first_row: int) -> FloatArray:
    """Maximum of a gain, whose first row is one of the picture, and of the whole picture's at half the size."""
    larger = np.empty_like(gain)

    def strip(first: int, end: int) -> None:
        enlarged = _enlarged(coarse, first_row + first, first_row + end, gain.shape[1])
        np.maximum(gain[first:end], enlarged, out=larger[first:end])

    parallel_rows(strip, len(gain))
    return larger


def _enlarged(plane: FloatArray, first: int, end: int, width: int) -> FloatArray:
    """Enlarge a plane to twice the size; return its rows from `first` to before `end`."""
    top = max(first // 2 - 1, 0)
    part = plane[top : end // 2 + 2]
    large = cv2.resize(part, (part.shape[1] * 2, part.shape[0] * 2), interpolation=cv2.INTER_LINEAR)
    return np.asarray(large[first - 2 * top : end - 2 * top, :width], np.float32)


def _shrink(blur: float, shorter_side: int) -> int:
    """Factor by which a picture may be reduced for this blur."""
    shrink = 1 << max(0, int(math.log2(blur / 1.5)))
    while shrink > 1 and shorter_side < 4 * shrink:
        shrink //= 2
    return shrink


def _reach(blur: float, shrink: int) -> int:
    """Radius in samples within which a blur's gain has to be the largest."""
    return max(1, int(blur / shrink))


def _max_of_four(plane: FloatArray, out: FloatArray | None = None) -> FloatArray:
    """Reduce a plane to half the size, by the largest of each four samples."""
    height, width = plane.shape
    fewer = np.empty((-(-height // 2), -(-width // 2)), np.float32) if out is None else out

    def strip(first: int, end: int) -> None:
        part = even(plane[2 * first : 2 * end])
        rows = np.maximum(part[0::2], part[1::2])
        np.maximum(rows[:, 0::2], rows[:, 1::2], out=fewer[first:end])

    parallel_rows(strip, len(fewer))
    return fewer
