"""Targets that move during the fit, depending on the current error.

The eye sees coarse errors better than fine ones. With K e the mean of an error e over small squares, (e + K e)^T V e is
minimised instead of e^T V e. Its gradient, V (e + K e), is that of the error against a target that lies K e further
away.

The eye also sees whether detail is as strong as it should be. Let x be an octave of the source, y that of the picture,
and s = (2 cov(x, y) + c) / (var x + var y + c) their structural similarity in a small window. Its gradient in y is
proportional to x - s y, like that of a squared error against x / s. Squared error alone leaves detail too weak where
Gaussians are few, except at its peaks. Fitted against x / s, it comes closer to the strength of the source.

So the target is moved every few steps, and the kernels need not know.
"""

from __future__ import annotations

from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.planes import all_halved, halved
from sgmethod.backend.protocol import TARGET_WHITE, Target
from sgmethod.fitting.bands import Rows, bands
from sgmethod.opencv import cv2
from sgmethod.scene import FloatArray
from sgmethod.settings.rd import MovingTargetSettings
from sgmethod.threads import in_parallel

LUMA = (0.299, 0.587, 0.114)


class MovingTarget:
    """A target [3, H, W] that stays where it is; subclasses move. Instances are immutable: moving returns another.

    now: the current target; hides: grain has been hidden already, or never will be.
    """

    hides = True

    def __init__(self, target: Target) -> None:
        self.now = self._original = target

    half = False  # whether moved() is given the error at half the size
    every = 16  # steps: the target may move before a step whose number is a multiple of this

    def is_due(self, _step: int, _has_grown: bool) -> bool:
        """Whether the target moves before this step. has_grown: the growth of this run is over."""
        return False

    def moved(self, _error: Rows) -> MovingTarget:
        """Return the target moved for this error: original target minus picture, by the target's rows."""
        return self

    def without(self, _grain: Target) -> MovingTarget:
        """Return the target with grain [3, H, W] to be subtracted at each move."""
        return self

    def whole(self) -> MovingTarget:
        """Return the target with its grain added back, for good."""
        return self


class ExaggeratedTarget(MovingTarget):
    """A target for the eye: exaggerates coarse errors and detail that the picture lacks, without hidden grain.

    It moves only after the growth of a run, which would take the difference for error and add wide Gaussians instead of
    correcting fine errors.
    """

    hides, half = False, True

    def __init__(self, target: Target, shrink: int, settings: MovingTargetSettings) -> None:
        """Start at the original target. shrink: coarse errors are means over squares of so many samples, at least 2."""
        super().__init__(target)
        self._settings, self._shrink, self.every = settings, shrink, settings.every
        self._grain: Target | None = None
        self._by: FloatArray | None = None  # offset for coarse errors, at 1 / shrink of the size
        self._detail: list[FloatArray] = []  # the source's luma by octave, from half the size on
        self._more: list[FloatArray] = []  # exaggeration of that detail, as factors
        self._kept: FloatArray | None = None  # share of detail left where grain is hidden, at half the size

    def is_due(self, step: int, has_grown: bool) -> bool:
        return has_grown and step % self.every == 0

    def without(self, grain: Target) -> ExaggeratedTarget:
        new = copy(self)
        new._grain, new.hides = grain, True
        finest = self._original[1] - _enlarged(halved(self._original[1]), grain.shape[1:])
        hidden, whole = (_spread_nearby(plane) for plane in (grain[1], finest))
        new._kept = 1 - np.minimum(hidden / (whole + 1), 1)
        return new

    def whole(self) -> ExaggeratedTarget:
        new = copy(self)
        if self._grain is not None:
            new.now = self.now + self._grain
        new._grain, new._kept, new.hides = None, None, True
        return new

    def moved(self, error: Rows) -> ExaggeratedTarget:
        new, s, (_, height, width) = copy(self), self._settings, self._original.shape
        coarse, luma = self._reduced(error)
        np.clip(coarse, -s.furthest, s.furthest, out=coarse)
        new._by = coarse if self._by is None else self._by + np.float32(s.rate) * (coarse - self._by)
        new._detail = self._detail or _octaves(self._reduced(self._source)[1], s)
        new._more = new._more_detail(luma)
        by_coarse = np.rint(new._by * TARGET_WHITE).astype(np.int16)
        by_detail = _enlarged(np.rint(new._exaggerated(luma.shape) * TARGET_WHITE).astype(np.int16), (height, width))
        new.now = np.empty_like(self._original)

        def move(k: int) -> None:
            np.add(self._original[k], _enlarged(by_coarse[k], (height, width)), out=new.now[k])
            new.now[k] += by_detail
            if self._grain is not None:
                new.now[k] -= self._grain[k]

        in_parallel(move, range(3))
        return new

    def _source(self, first: int, end: int) -> FloatArray:
        return all_halved(self._original[:, first:end].astype(np.float32) / np.float32(TARGET_WHITE))

    def _reduced(self, halves: Rows) -> tuple[FloatArray, FloatArray]:
        """Reduce planes of half the size to means over squares of `shrink`, [3, h, w], and to luma."""
        shrink, (_, height, width) = self._shrink, self._original.shape
        coarse = np.empty((3, -(-height // shrink), -(-width // shrink)), np.float32)
        luma = np.zeros((-(-height // 2), -(-width // 2)), np.float32)
        for first, end in bands(height, width):
            here = coarse[:, first // shrink : -(-end // shrink)]
            for plane, weight, to in zip(halves(first, end), LUMA, here, strict=True):
                luma[first // 2 : -(-end // 2)] += np.float32(weight) * plane
                to[...] = cv2.resize(plane, to.shape[::-1], interpolation=cv2.INTER_AREA)
        return coarse, luma

    def _more_detail(self, missing: FloatArray) -> list[FloatArray]:
        """Update the exaggeration of each octave of detail. missing: luma of the error at half the size."""
        s = self._settings
        more = [
            np.minimum(_unlikeness(source, source - less, s), most) - 1
            for source, less, most in zip(self._detail, _octaves(missing, s), s.most_detail, strict=True)
        ]
        before = self._more or more
        return [old + np.float32(s.detail_rate) * (new - old) for old, new in zip(before, more, strict=True)]

    def _exaggerated(self, size: tuple[int, ...]) -> FloatArray:
        """Detail to add to the target, at half the size."""
        by = [share * detail for share, detail in zip(self._more, self._detail, strict=True)]
        total = np.asarray(sum(_enlarged(octave, size) for octave in by), np.float32)
        return total if self._kept is None else total * self._kept  # else hidden grain would return as dots


class OvershootingTarget(MovingTarget):
    """A target for alpha: follows the picture beyond black and white, which decoding clamps.

    An edge may then overshoot instead of stopping at black or white, which Gaussians can hardly do; at steep edges it
    must, by a margin. Larger overshoot would show in reduced views, which are clamped only after they are drawn.
    """

    def __init__(self, target: Target, background: int, settings: MovingTargetSettings) -> None:
        """Start at the original target. background: the grey level that was subtracted from it."""
        super().__init__(target)
        s = self._settings = settings
        self.every = s.overshoot_every
        level = np.clip((target[0] + TARGET_WHITE // 510) // (TARGET_WHITE // 255) + background, 0, 255).astype(
            np.uint8
        )
        ends = [(level == 0).astype(np.float32), (level == 255).astype(np.float32)]
        margin = s.margin + s.of_slope * np.minimum(_slope(level), s.most_slope)
        # Range of offsets from the target within which the picture counts as right.
        self._low = ends[1] * margin - ends[0] * s.overshoot
        self._high = ends[1] * s.overshoot - ends[0] * margin

    def is_due(self, step: int, _has_grown: bool) -> bool:
        return step % self.every == 0

    def moved(self, error: Rows) -> OvershootingTarget:
        new, (_, height, width) = copy(self), self._original.shape
        new.now = np.empty_like(self._original)
        for first, end in bands(height, width):
            here = slice(first, end)
            beyond = np.clip(-error(first, end)[0], self._low[here], self._high[here])
            moved = np.rint(beyond * TARGET_WHITE).astype(np.int16)
            np.add(self._original[:, here], moved, out=new.now[:, here])
        return new


def _octaves(plane: FloatArray, settings: MovingTargetSettings) -> list[FloatArray]:
    """Split a plane into octaves of detail, finest first."""
    found = []
    for _ in settings.most_detail:
        coarse = halved(plane)
        found.append(plane - _enlarged(coarse, plane.shape))
        plane = coarse
    return found


def _unlikeness(source: FloatArray, drawn: FloatArray, settings: MovingTargetSettings) -> FloatArray:
    """Power of the inverse structural similarity around each sample of an octave; at least 1."""

    def mean(products: FloatArray) -> FloatArray:
        window = settings.detail_window
        return np.asarray(cv2.GaussianBlur(products, (0, 0), window, borderType=cv2.BORDER_REFLECT), np.float32)

    faint = np.float32((settings.faint_levels / 255) ** 2)
    both = mean(source * source + drawn * drawn) + faint
    return np.asarray((both / (np.maximum(2 * mean(source * drawn), 0) + faint)) ** settings.detail_power, np.float32)


def _spread_nearby(plane: Target) -> FloatArray:
    """Mean of |x| around each sample, at half the size."""
    return np.asarray(cv2.GaussianBlur(halved(np.abs(plane).astype(np.float32)), (0, 0), 4.0), np.float32)


def _enlarged(plane: NDArray[Any], size: tuple[int, ...]) -> NDArray[Any]:
    """Enlarge a plane to size (height, width)."""
    return np.asarray(cv2.resize(plane, size[::-1], interpolation=cv2.INTER_LINEAR))


def _slope(level: NDArray[np.uint8]) -> FloatArray:
    """Steepest change between neighbouring pixels near each pixel, 1 being white."""
    x, y = (
        cv2.Scharr(level, cv2.CV_32F, *by, scale=1 / (32 * 255), borderType=cv2.BORDER_REPLICATE)
        for by in ((1, 0), (0, 1))
    )
    return np.asarray(cv2.dilate(np.hypot(x, y), np.ones((3, 3), np.uint8)), np.float32)
