"""What of an error the eye sees, for files that are tuned to it.

An error e in red, green and blue counts (c |e|^2 + (l e)^2) V. The constants c and l (core/constants.h) make luma count
more than colour. V is the visibility of the pixel: the eye sees an error less where there is detail, which hides it.

That is a diagonal in place and a fixed matrix in colour. So the colours of given shapes are still a linear problem, and
the fit, growth, what is dropped and refining all see one and the same error.

Coarse errors are seen more than fine ones: with K e the mean of e over squares of SHRINK pixels, (e + K e)^T V e counts
in place of e^T V e. Its gradient, V (e + K e), is that of an error against a target further off by K e. So, once the
growth of a run of the schedule is over, the target is moved every few steps (leads.py), and kernels see nothing of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sgmethod.fitting.parameters import Parameters
from sgmethod.native import native
from sgmethod.scene import FloatArray

SHRINK = 4  # detail is that of a picture so many times smaller, which is what SSIMULACRA 2 looks at most
WINDOW = 1.5  # sigma of the window, in its samples
POWER = 0.5  # V falls with this power of the variance
SEEN_LEVELS = 9.0  # of 255: detail that is fainter hides nothing
LEAST, MOST = 1 / 32, 3.0  # of V, whose mean over detail is 1
LUMA = np.array([0.26, 0.66, 0.08], np.float32)  # about what the eye's cones add up to

COLOR = native.SEEN_COLOR * np.eye(3) + np.outer(native.SEEN_LUMA, native.SEEN_LUMA)
_VALUES, _AXES = np.linalg.eigh(COLOR)
COLOR_ROOT = ((_AXES * np.sqrt(_VALUES)) @ _AXES.T).astype(np.float32)


@dataclass(frozen=True)
class Visibility:
    """V of each pixel, int16 [H, W] with native.VISIBLE for 1; by_eye: whether luma counts more than colour, or all
    three channels alike."""

    values: NDArray[np.int16]
    by_eye: bool = True

    @property
    def color(self) -> NDArray[np.float64]:
        """[3, 3]: an error e of a pixel with V = 1 counts e^T color e."""
        return COLOR if self.by_eye else np.eye(3)

    def halved(self) -> Visibility:
        """At half the size: means of four."""
        height, width = self.values.shape
        size = (-(-width // 2), -(-height // 2))
        even = np.pad(self.values, ((0, height % 2), (0, width % 2)), mode="edge")
        small = np.asarray(cv2.resize(even, size, interpolation=cv2.INTER_AREA), np.int16)
        return Visibility(small, self.by_eye)


def shown_by(alpha: NDArray[np.uint8]) -> Visibility:
    """How much of an error is left of colours that alpha [H, W] shows on any background: its square."""
    share = alpha.astype(np.float32) / 255
    return Visibility(np.rint(share * share * native.VISIBLE).astype(np.int16), by_eye=False)


def visibility_of(pixels: NDArray[np.uint8], shown: Visibility | None = None) -> Visibility:
    """V of pixels [H, W, 3]; shown: as shown_by() gives it, for pixels that can be seen through."""
    height, width = pixels.shape[:2]
    size = (-(-width // SHRINK), -(-height // SHRINK))
    small = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA).astype(np.float32) @ LUMA
    variance = np.maximum(_blurred(small * small) - np.square(_blurred(small)), 0)
    seen = (2 * variance + np.float32(SEEN_LEVELS**2)) ** -np.float32(POWER)
    detail = np.sqrt(variance + 1)  # where there is more of it, there are more Gaussians
    seen *= np.sum(detail, dtype=np.float64) / np.sum(seen * detail, dtype=np.float64)
    levels = np.round(np.clip(seen, LEAST, MOST) * native.VISIBLE).astype(np.int16)
    levels = np.asarray(cv2.resize(levels, (width, height), interpolation=cv2.INTER_LINEAR), np.int16)
    if shown is not None:
        levels = (levels.astype(np.int32) * shown.values // native.VISIBLE).astype(np.int16)
    return Visibility(levels)


def _blurred(plane: FloatArray) -> FloatArray:
    return np.asarray(cv2.GaussianBlur(plane, (0, 0), WINDOW, borderType=cv2.BORDER_REFLECT), np.float32)


def amplitudes(visibility: Visibility, planes: FloatArray, first: int, end: int) -> FloatArray:
    """Rows [3, end - first, W] of an error, from the first to before end, whose squares are what is seen of it."""
    seen = np.sqrt(visibility.values[first:end].astype(np.float32) / native.VISIBLE)
    return np.asarray((np.tensordot(COLOR_ROOT, planes, 1) if visibility.by_eye else planes) * seen, np.float32)


def error(visibility: Visibility, decoded: NDArray[np.uint8], source: NDArray[np.uint8]) -> float:
    """What is seen of the error of a decoded picture [H, W, 3], summed; in squared levels of 255."""
    total, color = 0.0, visibility.color.astype(np.float32)
    for row, (a, b) in enumerate(zip(decoded, source, strict=True)):
        e = a.astype(np.float32) - b
        total += float(((e @ color) * e).sum(1) @ visibility.values[row].astype(np.float32))
    return total / native.VISIBLE


class Seen:
    """How much of each Gaussian's energy is seen."""

    def __init__(self, visibility: Visibility) -> None:
        self.color, self.levels = visibility.color, [visibility.values]
        while min(visibility.values.shape) > 1:
            visibility = visibility.halved()
            self.levels.append(visibility.values)

    @np.errstate(invalid="ignore")
    def of(self, p: Parameters) -> FloatArray:
        """The factor [N], by colour and by the mean visibility over about its size. A Gaussian whose centre is no
        number is seen as any place is, one whose size is none not at all."""
        means, factors, colors = p.arrays()
        size = 2 * np.sqrt(factors[:, 0] * factors[:, 2])
        level_of = np.clip(np.log2(np.maximum(size, 1)), 0, len(self.levels) - 1).astype(np.intp)
        seen = np.zeros(len(means), np.float32)
        for level, values in enumerate(self.levels):
            here = level_of == level
            x, y = (means[here] / 2**level).astype(np.intp).T
            height, width = values.shape
            seen[here] = values[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
        squares = np.maximum(np.square(colors).sum(1), 1e-20)
        return np.asarray(seen / native.VISIBLE * ((colors @ self.color) * colors).sum(1) / squares, np.float32)
