"""Visibility of errors at each pixel, for files that are tuned for the eye or have alpha.

An error e in red, green and blue counts (c |e|^2 + (l e)^2) V. The constants c and l (native/core/constants.h) make
luma count more than colour. V is the visibility of the pixel, which detail lowers. From the end of growth on, the mean
error of each square of 4 x 4 pixels counts once more (Visibility.coarse), because coarse errors are seen first.

The weights are diagonal over pixels and a fixed matrix over channels, so that finding the colours of given shapes is
still a linear problem.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.protocol import VISIBLE, Visibility, seen_difference, to_amplitudes
from sgmethod.opencv import cv2
from sgmethod.scene import FloatArray, Gaussians

SHRINK = 4  # detail is measured on a picture reduced by this, where SSIMULACRA 2 weighs it most
WINDOW = 1.5  # sigma of the window, in its samples
POWER = 0.5  # visibility falls with this power of the variance
SEEN_LEVELS = 9.0  # of 255: detail that is fainter hides nothing
MIN_WEIGHT, MAX_WEIGHT = 1 / 32, 3.0  # the mean over detail is 1
LUMA = (0.26, 0.66, 0.08)  # about the sum of the eye's cones


def of_alpha(alpha: NDArray[np.uint8]) -> Visibility:
    """Visibility of colours under alpha [H, W], on any background: alpha squared."""
    share = alpha.astype(np.float32) / 255
    return Visibility(np.rint(share * share * VISIBLE).astype(np.int16), by_eye=False)


def of_detail(pixels: NDArray[np.uint8], alpha: Visibility | None = None) -> Visibility:
    """Visibility to the eye of errors in pixels [H, W, 3], times the visibility under alpha if given."""
    height, width = pixels.shape[:2]
    size = (-(-width // SHRINK), -(-height // SHRINK))
    reduced = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    small = np.einsum("ijk,k->ij", reduced, np.array(LUMA, np.float32))
    variance = np.maximum(_blurred(small * small) - np.square(_blurred(small)), 0)
    visible = (2 * variance + np.float32(SEEN_LEVELS**2)) ** -np.float32(POWER)
    detail = np.sqrt(variance + 1)  # weights of the mean: there are more Gaussians where there is more detail
    visible *= np.sum(detail, dtype=np.float64) / np.sum(visible * detail, dtype=np.float64)
    levels = np.round(np.clip(visible, MIN_WEIGHT, MAX_WEIGHT) * VISIBLE).astype(np.int16)
    levels = np.asarray(cv2.resize(levels, (width, height), interpolation=cv2.INTER_LINEAR), np.int16)
    if alpha is not None:
        levels = (levels.astype(np.int32) * alpha.values // VISIBLE).astype(np.int16)
    return Visibility(levels)


def _blurred(plane: FloatArray) -> FloatArray:
    return np.asarray(cv2.GaussianBlur(plane, (0, 0), WINDOW, borderType=cv2.BORDER_REFLECT), np.float32)


def _color_root(visibility: Visibility) -> FloatArray:
    """Symmetric square root [3, 3] of the visibility's color."""
    values, axes = np.linalg.eigh(visibility.color)
    return np.asarray((axes * np.sqrt(values)) @ axes.T, np.float32)


def weigh(visibility: Visibility, planes: FloatArray, first: int) -> None:
    """Scale rows [3, N, W] of an error from row `first` on, in place, so that their squares are the weighted error."""
    root = _color_root(visibility).ravel() if visibility.by_eye else None
    to_amplitudes(planes, visibility.values[first : first + planes.shape[1]], root)


def error(visibility: Visibility, decoded: NDArray[np.uint8], source: NDArray[np.uint8]) -> float:
    """Weighted sum of squared errors of a decoded picture [H, W, 3], in squared levels of 255."""
    return seen_difference(decoded, source, visibility.values, visibility.by_eye, visibility.coarse) / VISIBLE


class VisibleShare:
    """Table to look up the visible share of Gaussians' energies."""

    def __init__(self, visibility: Visibility) -> None:
        self._color, self._levels = visibility.color, [visibility.values]
        while min(visibility.values.shape) > 1:
            visibility = visibility.half
            self._levels.append(visibility.values)

    def look_up(self, gaussians: Gaussians) -> FloatArray:
        """Visible share [N]. A NaN centre counts as the picture's corner, a NaN size as zero."""
        means, factors, colors = gaussians.arrays
        size = 2 * np.sqrt(factors[:, 0] * factors[:, 2])
        level_of = np.clip(np.log2(np.maximum(size, 1)), 0, len(self._levels) - 1).astype(np.intp)
        share = np.zeros(len(means), np.float32)
        for level, values in enumerate(self._levels):
            here = level_of == level
            x, y = (means[here] / 2**level).astype(np.intp).T
            height, width = values.shape
            share[here] = values[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
        squares = np.maximum(np.square(colors).sum(1), 1e-20)
        weighted = np.einsum("na,ab,nb->n", colors, self._color, colors)
        return np.asarray(share / VISIBLE * weighted / squares, np.float32)
