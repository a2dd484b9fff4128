"""Where another Gaussian would pay: matching pursuit on the residual at a few scales (profile rd).

Let e be the residual and w a round Gaussian of scale s at some place. Its best colour is <w, e> / <w, w>. That takes
its gain, <w, e>^2 / <w, w>, off the squared error.

The Gaussians of profile rd end at sigma = 3. Such a Gaussian is as wide as a whole one of scale b = 0.849 s. Its
integral is 0.801 2 pi s^2, its energy <w, w> is 0.412 2 pi s^2. With g the residual blurred by a normalised Gaussian
of scale b, the gain is therefore 4.33 pi b^2 |g|^2: one blur gives the gain at every place.

A place qualifies where its gain is the largest within the Gaussian's own size, and is more than its bits are worth.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from sgmethod.scene import FloatArray

BLURS_PX = (0.75, 1.5, 3.0, 6.0, 12.0, 24.0, 48.0)
SCALE_OF_BLUR = 1 / 0.84868  # s / b
GAIN = 4.327 * math.pi


def candidates(residual: FloatArray, most: int, least_gain: float) -> tuple[FloatArray, FloatArray]:
    """Means [N, 2] and factors [N, 3] of at most `most` round Gaussians for a residual [H, W, 3], each with a gain
    above least_gain, best first."""
    height, width = residual.shape[:2]
    # The gain of a wider one counts what lies outside, and hides every other place.
    blurs = [b for b in BLURS_PX if 4 * b <= max(height, width)] or [BLURS_PX[0]]
    gain = np.zeros((height, width), np.float32)
    chosen = np.zeros((height, width), np.uint8)  # index of the blur with that gain
    for index, b in enumerate(blurs):
        image = _blur(residual, b)
        found = cv2.transform(cv2.multiply(image, image, dst=image), np.full((1, 3), GAIN * b * b, np.float32))
        # Indices rise, so that the larger one is that of the larger gain.
        np.maximum(chosen, (found > gain).view(np.uint8) * np.uint8(index), out=chosen)
        np.maximum(gain, found, out=gain)
        del image, found  # before the next ones: of a large picture, one at a time
    rows, columns = np.nonzero(_peaks(gain, chosen, blurs) & (gain > least_gain))
    order = np.argsort(-gain[rows, columns], kind="stable")[: max(most, 0)]
    rows, columns = rows[order], columns[order]
    means = np.stack([columns, rows], 1).astype(np.float32) + 0.5
    scale = np.array(blurs, np.float32)[chosen[rows, columns]] * np.float32(SCALE_OF_BLUR)
    return means, np.stack([scale, 0 * scale, scale], 1)


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


def _peaks(gain: FloatArray, chosen: NDArray[np.uint8], blurs: list[float]) -> NDArray[np.bool_]:
    """Where [H, W] the gain is the largest within the chosen blur's own size."""
    peaks = np.zeros(gain.shape, np.bool_)
    largest, reach = gain, 0  # within so many pixels
    for index, b in enumerate(blurs):
        wider = max(1, int(b))
        if wider > reach:  # windows of windows: a wide one at once takes its width in time
            side = 2 * (wider - reach) + 1
            largest = np.asarray(cv2.dilate(largest, np.ones((side, side), np.uint8)), np.float32)
            reach = wider
        peaks |= (gain >= largest) & (chosen == index)
    return peaks
