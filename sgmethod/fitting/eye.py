"""What of an error the eye sees, for files that are tuned to it.

An error e in red, green and blue counts (c |e|^2 + (l e)^2) V. The constants c and l (core/constants.h) make luma count
more than colour. V is the visibility of the pixel: the eye sees an error less where there is detail, which hides it.

That is a diagonal in place and a fixed matrix in colour. So the colours of given shapes are still a linear problem, and
the fit, growth, what is dropped and refining all see one and the same error.

Coarse errors are seen more than fine ones: with K e the mean of e over squares of SHRINK pixels, (e + K e)^T V e counts
in place of e^T V e. Its gradient, V (e + K e), is that of an error against a target further off by K e. So, once the
growth of a run of the schedule is over, the target is moved every few steps (Lead), and kernels see nothing of it.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from sgmethod.fitting.parameters import Parameters
from sgmethod.native import native
from sgmethod.scene import FloatArray

Visibility = NDArray[np.int16]

SHRINK = 4  # detail is that of a picture so many times smaller, which is what SSIMULACRA 2 looks at most
WINDOW = 1.5  # sigma of the window, in its samples
POWER = 0.5  # V falls with this power of the variance
SEEN_LEVELS = 9.0  # of 255: detail that is fainter hides nothing
LEAST, MOST = 1 / 32, 3.0  # of V, whose mean over detail is 1
BAND = 256  # rows, a multiple of SHRINK
LUMA = np.array([0.26, 0.66, 0.08], np.float32)  # about what the eye's cones add up to

COLOR = native.SEEN_COLOR * np.eye(3) + np.outer(native.SEEN_LUMA, native.SEEN_LUMA)
_VALUES, _AXES = np.linalg.eigh(COLOR)
COLOR_ROOT = ((_AXES * np.sqrt(_VALUES)) @ _AXES.T).astype(np.float32)


def visibility_of(pixels: NDArray[np.uint8]) -> Visibility:
    """V of pixels [H, W, 3], in int16 [H, W] with native.VISIBLE for 1."""
    height, width = pixels.shape[:2]
    size = (-(-width // SHRINK), -(-height // SHRINK))
    small = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA).astype(np.float32) @ LUMA
    variance = np.maximum(_blurred(small * small) - np.square(_blurred(small)), 0)
    seen = (2 * variance + np.float32(SEEN_LEVELS**2)) ** -np.float32(POWER)
    detail = np.sqrt(variance + 1)  # where there is more of it, there are more Gaussians
    seen *= np.sum(detail, dtype=np.float64) / np.sum(seen * detail, dtype=np.float64)
    levels = np.round(np.clip(seen, LEAST, MOST) * native.VISIBLE).astype(np.int16)
    return np.asarray(cv2.resize(levels, (width, height), interpolation=cv2.INTER_LINEAR), np.int16)


class Lead:
    """The target of a fit, moved by its coarse error as that was lately."""

    EVERY = 4  # steps
    RATE = 0.15  # of the way to the error of now, at once: from 0.5 on, target and fit swing ever wider
    FURTHEST = 0.1  # 1 being white

    def __init__(self, target: NDArray[np.int16]) -> None:
        """target [3, H, W], in which native.TARGET_WHITE is white."""
        self.unmoved, self.target = target, target
        _, height, width = target.shape
        self.size = (-(-height // SHRINK), -(-width // SHRINK))
        self.by: FloatArray | None = None  # [3, *size]

    def follow(self, error: Callable[[int, int], FloatArray]) -> None:
        """Move the target. error: target, unmoved, less picture, by rows as Picture.residual() gives them."""
        _, height, width = self.unmoved.shape
        coarse = np.empty((3, *self.size), np.float32)
        for first in range(0, height, BAND):
            end = min(first + BAND, height)
            here = slice(first // SHRINK, -(-end // SHRINK))
            for plane, to in zip(error(first, end), coarse[:, here], strict=True):
                to[...] = cv2.resize(plane, to.shape[::-1], interpolation=cv2.INTER_AREA)
        np.clip(coarse, -self.FURTHEST, self.FURTHEST, out=coarse)
        self.by = coarse if self.by is None else self.by + np.float32(self.RATE) * (coarse - self.by)
        self.target = np.empty_like(self.unmoved)
        for plane, by, to in zip(self.unmoved, self.by, self.target, strict=True):
            moved = cv2.resize(by * native.TARGET_WHITE, (width, height), interpolation=cv2.INTER_LINEAR)
            np.rint(moved, out=moved)
            np.add(plane, moved.astype(np.int16), out=to)


def _blurred(plane: FloatArray) -> FloatArray:
    return np.asarray(cv2.GaussianBlur(plane, (0, 0), WINDOW, borderType=cv2.BORDER_REFLECT), np.float32)


def halved(visibility: Visibility) -> Visibility:
    """At half the size: means of four."""
    height, width = visibility.shape
    size = (-(-width // 2), -(-height // 2))
    even = np.pad(visibility, ((0, height % 2), (0, width % 2)), mode="edge")
    return np.asarray(cv2.resize(even, size, interpolation=cv2.INTER_AREA), np.int16)


def amplitudes(visibility: Visibility, planes: FloatArray) -> FloatArray:
    """An error [3, H, W] whose plain squares are what the eye sees of it."""
    seen = np.sqrt(visibility.astype(np.float32) / native.VISIBLE)
    return np.asarray(np.tensordot(COLOR_ROOT, planes, 1) * seen, np.float32)


def error(visibility: Visibility, decoded: NDArray[np.uint8], source: NDArray[np.uint8]) -> float:
    """What the eye sees of the error of a decoded picture [H, W, 3], summed; in squared levels of 255."""
    total, color = 0.0, COLOR.astype(np.float32)
    for row, (a, b) in enumerate(zip(decoded, source, strict=True)):
        e = a.astype(np.float32) - b
        total += float(((e @ color) * e).sum(1) @ visibility[row].astype(np.float32))
    return total / native.VISIBLE


class Seen:
    """How much of each Gaussian's energy the eye sees."""

    def __init__(self, visibility: Visibility) -> None:
        self.levels = [visibility]
        while min(self.levels[-1].shape) > 1:
            self.levels.append(halved(self.levels[-1]))

    def of(self, p: Parameters) -> FloatArray:
        """The factor [N], by colour and by the mean visibility over about its size."""
        means, factors, colors = p.arrays()
        size = 2 * np.sqrt(factors[:, 0] * factors[:, 2])
        level_of = np.clip(np.log2(np.maximum(size, 1)), 0, len(self.levels) - 1).astype(np.intp)
        seen = np.empty(len(means), np.float32)
        for level, values in enumerate(self.levels):
            here = level_of == level
            x, y = (means[here] / 2**level).astype(np.intp).T
            height, width = values.shape
            seen[here] = values[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
        squares = np.maximum(np.square(colors).sum(1), 1e-20)
        return np.asarray(seen / native.VISIBLE * ((colors @ COLOR) * colors).sum(1) / squares, np.float32)
