"""Targets that move during the fit, depending on the current error.

The eye sees whether detail is as strong as it should be. Let x be an octave of the source, y the same octave of the
picture, and s = (2 cov(x, y) + c) / (var x + var y + c) their structural similarity in a small window. Its gradient in
y is proportional to x - s y, like that of a squared error against x / s. Squared error alone leaves detail too weak
where Gaussians are few, except at its peaks. Fitted against x / s, it comes closer to the strength of the source.

The eye also sees coarse errors better than fine ones. With K e the mean of an error e over small squares, the fit
minimises e^T V e + w (K e)^T V (K e) (Visibility.coarse), whose gradient is V (e + w K e). That is the gradient of
e^T V e against a target that lies w K e further away, which refining is given: it weighs each pixel alone.

A target moves only every few steps, and part of the way, or it and the fit would swing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.planes import all_halved, halved
from sgmethod.backend.protocol import TARGET_WHITE, Target
from sgmethod.fitting.bands import Rows, bands, parallel_rows
from sgmethod.opencv import cv2
from sgmethod.scene import FloatArray
from sgmethod.threads import in_parallel

LUMA = (0.299, 0.587, 0.114)
# For the eye.
EVERY = 12  # steps
MAX_DETAIL = (3.0, 1.4)  # in multiples of the source's, by octave, finest first
DETAIL_WINDOW = 1.4  # sigma, in samples of the octave; small, so that peaks do not hide their surroundings
DETAIL_POWER = 1.15  # of the inverse of structural similarity
DETAIL_RATE = 0.5  # part of the way per move
FAINT_LEVELS = 2.0  # of 8 bits: fainter detail is not exaggerated
# For alpha.
OVERSHOOT = 0.4  # most overshoot allowed, 1 being white
OVERSHOOT_EVERY = 2  # steps
MARGIN = 0.02  # overshoot asked for at least
OF_SLOPE = 0.3  # additional overshoot, in multiples of the steepest change between neighbouring pixels
MAX_SLOPE = 0.67


@dataclass(frozen=True, eq=False)
class FitTarget:
    """A target of the fit that stays as it is. Subclasses move, in the memory of the target before.

    original: the picture, [3, H, W]; now: what the fit aims at; every: in steps, the target may move before a step
    whose number is a multiple of this; hides: grain has been hidden already, or never will be.
    """

    half: ClassVar[bool] = False  # whether moved() is given the error at half the size

    original: Target
    now: Target
    every: int = 16
    hides: bool = True

    def is_due(self, _step: int, _has_grown: bool) -> bool:
        """Whether the target moves before this step. has_grown: the growth of this run is over."""
        return False

    def moved(self, _error: Rows) -> FitTarget:
        """Return the target moved for this error: original target minus picture, by the target's rows."""
        return self

    def without(self, _grain: Target) -> FitTarget:
        """Return the target with grain [3, H, W] subtracted, in the grain's memory."""
        return self

    @property
    def room(self) -> Target:
        """Memory for the next move: this target's own, once it is not the picture itself."""
        return np.empty_like(self.now) if self.now is self.original else self.now


@dataclass(frozen=True, eq=False, kw_only=True)
class ExaggeratedTarget(FitTarget):
    """A target for the eye: exaggerates detail that the picture lacks, without hidden grain.

    It moves only after the growth of a run, which would take the difference for error.
    detail: the source's luma by octave, from half the size on; more: its exaggeration, as factors; added: what that
    adds to the target, at half the size; kept: share of detail left where grain is hidden, at half the size.
    """

    half = True

    detail: tuple[FloatArray, ...] = ()
    more: tuple[FloatArray, ...] = ()
    added: NDArray[np.int16] | None = None
    kept: FloatArray | None = None

    @classmethod
    def from_target(cls, target: Target, *, hides: bool) -> ExaggeratedTarget:
        """Start at the original target. hides: no grain will be hidden."""
        return cls(target, target, EVERY, hides)

    def is_due(self, step: int, has_grown: bool) -> bool:
        return has_grown and step % self.every == 0

    def without(self, grain: Target) -> ExaggeratedTarget:
        finest = self.original[1] - _enlarged(halved(self.original[1]), grain.shape[1:])
        hidden, whole = (_spread_nearby(plane) for plane in (grain[1], finest))
        kept = 1 - np.minimum(hidden / (whole + 1), 1)
        now = _in_planes(np.subtract, self.now, grain, grain)
        return replace(self, now=now, kept=kept, hides=True)

    def moved(self, error: Rows) -> ExaggeratedTarget:
        detail = self.detail or _octaves(self._luma(self._source))
        more = self._more_detail(detail, _octaves(self._luma(error)))
        added, now = self._exaggerated(detail, more), self.now
        if self.added is not None:
            _in_planes(np.subtract, now, self._enlarged_whole(self.added), now)
        now = _in_planes(np.add, now, self._enlarged_whole(added), self.room)
        return replace(self, now=now, detail=detail, more=more, added=added)

    def _enlarged_whole(self, half: NDArray[np.int16]) -> NDArray[np.int16]:
        return _enlarged(half, self.original.shape[1:])

    def _source(self, first: int, end: int) -> FloatArray:
        return all_halved(self.original[:, first:end].astype(np.float32) / np.float32(TARGET_WHITE))

    def _luma(self, halves: Rows) -> FloatArray:
        """Luma of planes of half the size."""
        _, height, width = self.original.shape
        luma = np.zeros((-(-height // 2), -(-width // 2)), np.float32)
        for first, end in bands(height, width):
            planes, part = halves(first, end), luma[first // 2 : -(-end // 2)]

            def strip(top: int, bottom: int, planes: FloatArray = planes, part: FloatArray = part) -> None:
                for plane, weight in zip(planes[:, top:bottom], LUMA, strict=True):
                    part[top:bottom] += np.float32(weight) * plane

            parallel_rows(strip, len(part))
        return luma

    def _more_detail(self, detail: tuple[FloatArray, ...], missing: tuple[FloatArray, ...]) -> tuple[FloatArray, ...]:
        """Update the exaggeration of each octave of detail, in place. missing: luma of the error by octave."""
        margin = math.ceil(4 * DETAIL_WINDOW) + 1  # to the ends of a blur's kernel

        def moved(octave: int, less: FloatArray) -> FloatArray:
            source, moved = detail[octave], self.more[octave] if self.more else np.empty_like(less)

            def strip(first: int, end: int) -> None:
                top, bottom = max(first - margin, 0), min(end + margin, len(source))
                part = source[top:bottom]
                unlike = _unlikeness(part, part - less[top:bottom])[first - top : end - top]
                new = np.minimum(unlike, MAX_DETAIL[octave]) - 1
                old = moved[first:end] if self.more else new
                moved[first:end] = old + np.float32(DETAIL_RATE) * (new - old)

            parallel_rows(strip, len(source))
            return moved

        return tuple(moved(octave, less) for octave, less in enumerate(missing))

    def _exaggerated(self, detail: tuple[FloatArray, ...], more: tuple[FloatArray, ...]) -> NDArray[np.int16]:
        """Detail to add to the target, at half the size."""
        total = more[0] * detail[0]
        for share, octave in zip(more[1:], detail[1:], strict=True):
            total += _enlarged(share * octave, total.shape)
        if self.kept is not None:  # else hidden grain would return as dots
            total *= self.kept
        total *= TARGET_WHITE
        return np.asarray(np.rint(total, out=total), np.int16)


@dataclass(frozen=True, eq=False, kw_only=True)
class OvershootingTarget(FitTarget):
    """A target for alpha: follows the picture beyond black and white, which decoding clamps.

    An edge may then overshoot instead of stopping at black or white, which Gaussians can hardly do; at steep edges it
    must, by a margin. Larger overshoot would show in reduced views, which are clamped only after they are drawn.
    range: least and greatest offset [2, H, W] from the target with which the picture counts as right.
    """

    range: FloatArray

    @classmethod
    def from_target(cls, target: Target, background: int) -> OvershootingTarget:
        """Start at the original target. background: the grey level that was subtracted from it."""
        level = np.clip((target[0] + TARGET_WHITE // 510) // (TARGET_WHITE // 255) + background, 0, 255)
        level = level.astype(np.uint8)
        black, white = (level == 0).astype(np.float32), (level == 255).astype(np.float32)
        margin = MARGIN + OF_SLOPE * np.minimum(_slope(level), MAX_SLOPE)
        low, high = white * margin - black * OVERSHOOT, white * OVERSHOOT - black * margin
        return cls(target, target, OVERSHOOT_EVERY, range=np.stack([low, high]))

    def is_due(self, step: int, _has_grown: bool) -> bool:
        return step % self.every == 0

    def moved(self, error: Rows) -> OvershootingTarget:
        now, (_, height, width) = self.room, self.original.shape
        for first, end in bands(height, width):
            beyond = np.clip(-error(first, end)[0], *self.range[:, first:end])
            moved = np.rint(beyond * TARGET_WHITE).astype(np.int16)
            np.add(self.original[:, first:end], moved, out=now[:, first:end])
        return replace(self, now=now)


def led(target: Target, error: Rows, weight: float, shrink: int, into: Target | None = None) -> Target:
    """Move a target further away by `weight` times the mean error of each square of 2 shrink samples.

    error: original target minus picture, at half the size, by the target's rows; into: memory for the result, maybe the
    target's own.
    """
    _, height, width = target.shape
    means = np.empty((3, -(-height // (2 * shrink)), -(-width // (2 * shrink))), np.float32)
    for first, end in bands(height, width):
        planes, here = error(first, end), means[:, first // (2 * shrink) : -(-end // (2 * shrink))]
        for plane, mean in zip(planes, here, strict=True):
            cv2.resize(plane, mean.shape[::-1], mean, interpolation=cv2.INTER_AREA)
    by = np.rint(np.float32(weight * TARGET_WHITE) * means).astype(np.int16)
    moved = np.empty_like(target) if into is None else into

    def enlarge(plane: int) -> None:
        np.add(_enlarged(by[plane], (height, width)), target[plane], out=moved[plane])

    in_parallel(enlarge, range(3))
    return moved


def _octaves(plane: FloatArray) -> tuple[FloatArray, ...]:
    """Split a plane into octaves of detail, finest first."""
    found = []
    for _ in MAX_DETAIL:
        coarse = halved(plane)
        finer = _enlarged(coarse, plane.shape)
        found.append(np.subtract(plane, finer, out=finer))
        plane = coarse
    return tuple(found)


def _unlikeness(source: FloatArray, drawn: FloatArray) -> FloatArray:
    """Power of the inverse structural similarity around each sample of an octave; at least 1."""

    def mean(products: FloatArray) -> FloatArray:
        return np.asarray(cv2.GaussianBlur(products, (0, 0), DETAIL_WINDOW, borderType=cv2.BORDER_REFLECT), np.float32)

    faint = np.float32((FAINT_LEVELS / 255) ** 2)
    both = mean(source * source + drawn * drawn) + faint
    return np.asarray((both / (np.maximum(2 * mean(source * drawn), 0) + faint)) ** DETAIL_POWER, np.float32)


def _in_planes(function: np.ufunc, target: Target, by: Target | NDArray[np.int16], out: Target) -> Target:
    """Apply a function to a target and to another, or to each of its planes and one plane; into `out`."""

    def strip(first: int, end: int) -> None:
        function(target[:, first:end], by[..., first:end, :], out=out[:, first:end])

    parallel_rows(strip, target.shape[1])
    return out


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
