"""Where another Gaussian would pay: matching pursuit on the residual at a few scales (profile rd).

For a round Gaussian w of scale s at a place, the best colour is <w, e> / <w, w> with e the residual, and it takes
<w, e>^2 / <w, w> off the squared error. With g_s the residual blurred by a normalised Gaussian of scale s that is a
gain of 4 pi s^2 |g_s|^2 with colour 2 g_s. A place qualifies where the gain is a local maximum over its own size and
exceeds what the Gaussian's bits are worth.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from sgmethod.gaussians import FloatArray, Gaussians

Indices = NDArray[np.int64]

SCALES_PX = (0.75, 1.5, 3.0, 6.0, 12.0, 24.0, 48.0)


def candidates(residual: FloatArray, most: int, least_gain: float) -> Gaussians:
    """At most `most` round Gaussians for a residual [H, W, 3], each with a gain above least_gain, best first.

    Each has the colour that would be best if it were alone.
    """
    height, width = residual.shape[:2]
    # The gain of a wider one counts what lies outside, and hides every other place.
    scales = [s for s in SCALES_PX if 4 * s <= max(height, width)] or [SCALES_PX[0]]
    gain = np.zeros((height, width), np.float32)
    color = np.zeros_like(residual)
    scale = np.zeros((height, width), np.float32)
    for s in scales:
        blurred = _blur(residual, s)
        found = (4 * math.pi * s * s) * np.einsum("ijk,ijk->ij", blurred, blurred)
        better = found > gain
        gain[better], scale[better], color[better] = found[better], s, 2 * blurred[better]
    rows, columns = _peaks(gain, scale, scales, least_gain)
    order = np.argsort(-gain[rows, columns], kind="stable")[: max(most, 0)]
    rows, columns = rows[order], columns[order]
    means = np.stack([columns, rows], 1).astype(np.float32) + 0.5
    chosen = scale[rows, columns]
    factors = np.stack([chosen, 0 * chosen, chosen], 1)
    return Gaussians(means, factors, color[rows, columns])


def _blur(image: FloatArray, sigma: float) -> FloatArray:
    """Gaussian blur; wide ones on a smaller picture, where the same blur takes a fraction of the time."""
    shrink = 1 << max(0, int(math.log2(sigma / 3)) if sigma > 3 else 0)
    height, width = image.shape[:2]
    if shrink == 1 or min(height, width) < 4 * shrink:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REFLECT), np.float32)
    size = (-(-width // shrink), -(-height // shrink))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), sigma / shrink, borderType=cv2.BORDER_REFLECT)
    return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)


def _peaks(gain: FloatArray, scale: FloatArray, scales: list[float], least_gain: float) -> tuple[Indices, Indices]:
    """Rows and columns where the gain is the largest within the chosen scale's own size."""
    rows, columns = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for s in scales:
        side = max(3, int(2 * s) | 1)
        top = cv2.dilate(gain, np.ones((side, side), np.uint8))
        found = np.nonzero((gain >= top) & (scale == np.float32(s)) & (gain > least_gain))
        rows.append(found[0])
        columns.append(found[1])
    return np.concatenate(rows), np.concatenate(columns)
