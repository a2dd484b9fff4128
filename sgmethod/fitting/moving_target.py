"""A target that moves during the fit, as a function of how far the picture is from it.

The eye sees coarse errors more than fine ones. With K e the mean of an error e over small squares, (e + K e)^T V e
counts in place of e^T V e. Its gradient, V (e + K e), is that of an error against a target that lies K e further off.

It also sees whether detail is as strong as it should be. Let x be an octave of the source, y that of the picture, and
s = (2 cov(x, y) + c) / (var x + var y + c) their structural similarity in a small window. Its gradient in y goes with
x - s y, as that of a squared error against x / s does. Squared error alone leaves too weak whatever few Gaussians can
follow, but for its peaks. Against x / s it comes nearer to the strength of the source.

So the target is moved every few steps, and kernels see nothing of it.
"""

from __future__ import annotations

from copy import copy
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.planes import halved
from sgmethod.backend.protocol import TARGET_WHITE, Target
from sgmethod.fitting.bands import Rows, bands
from sgmethod.scene import FloatArray
from sgmethod.settings.rd import MovingTargetSettings

LUMA = (0.299, 0.587, 0.114)


class MovingTarget:
    """A target, [3, H, W], which never moves unless a subclass says how. Moving gives another one.

    now: where it is; hides: grain was hidden already, or never will be.
    """

    hides = True

    def __init__(self, target: Target) -> None:
        self.now = self._original = target

    def is_due(self, _step: int, _has_grown: bool) -> bool:
        """Whether it moves before this step; has_grown: the growth of this run is over."""
        return False

    def moved(self, _error: Rows) -> MovingTarget:
        """The target for a picture this far off: the original target less the picture, by rows."""
        return self

    def without(self, _grain: Target) -> MovingTarget:
        """The target with this much, [3, H, W], taken off each time that it is moved."""
        return self

    def whole(self) -> MovingTarget:
        """The target with what was taken off put back, for good."""
        return self


class AheadForTheEye(MovingTarget):
    """Runs ahead of recent coarse errors, and exaggerates detail that the picture follows badly, less the grain that is
    hidden.

    Only once the growth of a run is over: growth would take the difference for error, add wide Gaussians and leave fine
    errors alone.
    """

    hides = False

    def __init__(self, target: Target, shrink: int, settings: MovingTargetSettings) -> None:
        """shrink: coarse errors are means over squares of this side, in samples of the target; at least 2."""
        super().__init__(target)
        self._settings, self._shrink = settings, shrink
        self._grain: Target | None = None
        self._by: FloatArray | None = None  # at a fraction of the size
        self._detail: list[FloatArray] = []  # of luma, by octave from half the size on
        self._more: list[FloatArray] = []  # of that detail
        self._kept: FloatArray | None = None  # of the detail, where grain is hidden; at half the size

    def is_due(self, step: int, has_grown: bool) -> bool:
        return has_grown and step % self._settings.every == 0

    def without(self, grain: Target) -> AheadForTheEye:
        new = copy(self)
        new._grain, new.hides = grain, True
        finest = self._original[1] - _enlarged(halved(self._original[1]), grain.shape[1:])
        hidden, whole = (_spread_nearby(plane) for plane in (grain[1], finest))
        new._kept = 1 - np.minimum(hidden / (whole + 1), 1)
        return new

    def whole(self) -> AheadForTheEye:
        new = copy(self)
        if self._grain is not None:
            new.now = self.now + self._grain
        new._grain, new._kept, new.hides = None, None, True
        return new

    def moved(self, error: Rows) -> AheadForTheEye:
        new, s, (_, height, width) = copy(self), self._settings, self._original.shape
        coarse, luma = self._reduced(error)
        np.clip(coarse, -s.furthest, s.furthest, out=coarse)
        new._by = coarse if self._by is None else self._by + np.float32(s.rate) * (coarse - self._by)
        new._detail = self._detail or _octaves(self._reduced(self._source)[1], s)
        new._more = new._more_detail(luma)
        by_coarse = np.rint(new._by * TARGET_WHITE).astype(np.int16)
        by_detail = _enlarged(np.rint(new._exaggerated(luma.shape) * TARGET_WHITE).astype(np.int16), (height, width))
        new.now = np.empty_like(self._original)
        for plane, by, to in zip(self._original, by_coarse, new.now, strict=True):
            np.add(plane, _enlarged(by, (height, width)), out=to)
            to += by_detail
        if self._grain is not None:
            new.now -= self._grain
        return new

    def _source(self, first: int, end: int) -> FloatArray:
        return self._original[:, first:end].astype(np.float32) / np.float32(TARGET_WHITE)

    def _reduced(self, planes: Rows) -> tuple[FloatArray, FloatArray]:
        """Means over squares of `shrink`, [3, h, w], and luma at half the size."""
        shrink, (_, height, width) = self._shrink, self._original.shape
        coarse = np.empty((3, -(-height // shrink), -(-width // shrink)), np.float32)
        luma = np.zeros((-(-height // 2), -(-width // 2)), np.float32)
        for first, end in bands(height, width):
            here = coarse[:, first // shrink : -(-end // shrink)]
            for plane, weight, to in zip(planes(first, end), LUMA, here, strict=True):
                half = halved(plane)
                luma[first // 2 : -(-end // 2)] += np.float32(weight) * half
                to[...] = cv2.resize(half, to.shape[::-1], interpolation=cv2.INTER_AREA)
        return coarse, luma

    def _more_detail(self, missing: FloatArray) -> list[FloatArray]:
        """How much stronger each octave of the detail is asked for now. missing: luma of the error at half the size."""
        s = self._settings
        more = [
            np.minimum(_unlikeness(source, source - less, s), most) - 1
            for source, less, most in zip(self._detail, _octaves(missing, s), s.most_detail, strict=True)
        ]
        before = self._more or more
        return [old + np.float32(s.detail_rate) * (new - old) for old, new in zip(before, more, strict=True)]

    def _exaggerated(self, size: tuple[int, ...]) -> FloatArray:
        """What is added to the target's detail, at half the size."""
        by = [share * detail for share, detail in zip(self._more, self._detail, strict=True)]
        total = np.asarray(sum(_enlarged(octave, size) for octave in by), np.float32)
        return total if self._kept is None else total * self._kept  # or hidden grain would return as dots


class BeyondBlackAndWhite(MovingTarget):
    """Wherever the picture is beyond black or white, which decoding clamps; for alpha.

    So an edge need not end where it comes to black or white, which a Gaussian finds hard. Where it is steep, a margin
    beyond is asked for. Values much further out would show in reductions, which are drawn smaller before they are
    clamped.
    """

    def __init__(self, target: Target, background: int, settings: MovingTargetSettings) -> None:
        """background: the grey level that the target is above."""
        super().__init__(target)
        s = self._settings = settings
        level = np.clip((target[0] + TARGET_WHITE // 510) // (TARGET_WHITE // 255) + background, 0, 255).astype(
            np.uint8
        )
        ends = [(level == 0).astype(np.float32), (level == 255).astype(np.float32)]
        margin = s.margin + s.of_slope * np.minimum(_slope(level), s.most_slope)
        # From the target to the nearest and the furthest that the picture may be beyond it.
        self._low = ends[1] * margin - ends[0] * s.overshoot
        self._high = ends[1] * s.overshoot - ends[0] * margin

    def is_due(self, step: int, _has_grown: bool) -> bool:
        return step % self._settings.overshoot_every == 0

    def moved(self, error: Rows) -> BeyondBlackAndWhite:
        new, (_, height, width) = copy(self), self._original.shape
        new.now = np.empty_like(self._original)
        for first, end in bands(height, width):
            here = slice(first, end)
            beyond = np.clip(-error(first, end)[0], self._low[here], self._high[here])
            moved = np.rint(beyond * TARGET_WHITE).astype(np.int16)
            np.add(self._original[:, here], moved, out=new.now[:, here])
        return new


def _octaves(plane: FloatArray, settings: MovingTargetSettings) -> list[FloatArray]:
    """The detail of a plane that half the size cannot show, that of half the size, and so on."""
    found = []
    for _ in settings.most_detail:
        coarse = halved(plane)
        found.append(plane - _enlarged(coarse, plane.shape))
        plane = coarse
    return found


def _unlikeness(source: FloatArray, drawn: FloatArray, settings: MovingTargetSettings) -> FloatArray:
    """1 or more: a power of the inverse of the structural similarity around each sample of an octave."""

    def mean(products: FloatArray) -> FloatArray:
        window = settings.detail_window
        return np.asarray(cv2.GaussianBlur(products, (0, 0), window, borderType=cv2.BORDER_REFLECT), np.float32)

    faint = np.float32((settings.faint_levels / 255) ** 2)
    both = mean(source * source + drawn * drawn) + faint
    return np.asarray((both / (np.maximum(2 * mean(source * drawn), 0) + faint)) ** settings.detail_power, np.float32)


def _spread_nearby(plane: Target) -> FloatArray:
    """The mean of |x| around each sample, at half the size."""
    return np.asarray(cv2.GaussianBlur(halved(np.abs(plane).astype(np.float32)), (0, 0), 4.0), np.float32)


def _enlarged(plane: NDArray[Any], size: tuple[int, ...]) -> NDArray[Any]:
    """To (height, width)."""
    return np.asarray(cv2.resize(plane, size[::-1], interpolation=cv2.INTER_LINEAR))


def _slope(level: NDArray[np.uint8]) -> FloatArray:
    """The largest change from pixel to pixel near each of them, 1 being white."""
    x, y = (
        cv2.Scharr(level, cv2.CV_32F, *by, scale=1 / (32 * 255), borderType=cv2.BORDER_REPLICATE)
        for by in ((1, 0), (0, 1))
    )
    return np.asarray(cv2.dilate(np.hypot(x, y), np.ones((3, 3), np.uint8)), np.float32)
