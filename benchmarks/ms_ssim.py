"""MS-SSIM of two pictures, in which tables of results compare codecs too.

Windows are in float32, which changes it by less than 1e-6; sums are in float64.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sgmethod.backend.planes import halved
from sgmethod.metrics.pixels import Pixels, peak_of
from sgmethod.metrics.visual import WINDOW_SIZE, window_weights
from sgmethod.numerics import quiet
from sgmethod.opencv import cv2
from sgmethod.threads import in_parallel

Plane = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]

# Wang, Simoncelli and Bovik, "Multi-scale structural similarity for image quality assessment", 2003:
# section 3.2 gives the exponents of the five scales (beta_j = gamma_j, and alpha_5 equals the last).
SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
C1, C2 = 0.01**2, 0.03**2  # of Wang, Bovik, Sheikh and Simoncelli, "Image quality assessment", 2004, III.B

BAND = 1 << 16  # windows compared at a time, about

# The window must fit at the coarsest of the five scales: a side of 161 has 11 pixels there, 160 has 10.
MS_SSIM_SIDE = (WINDOW_SIZE - 1) * 2 ** (len(SCALE_WEIGHTS) - 1) + 1


@quiet
def ms_ssim(a: Pixels, b: Pixels) -> float | None:
    """Multi-scale structural similarity of two pictures [H, W, C], mean over channels, in [0, 1].

    None if the shorter side is below MS_SSIM_SIDE = 161 pixels, where the measure is undefined. Five scales; only
    windows inside the picture; between scales means over 2 x 2 pixels, with a zero put in front of an odd side; a
    negative mean of any scale counts as 0. These are the choices of the package pytorch-msssim, whose figures are
    usually published.
    """
    peak = peak_of(a, b)
    if a.ndim != 3:
        raise ValueError(f"pictures must be [H, W, C], got {list(a.shape)}")
    if min(a.shape[:2]) < MS_SSIM_SIDE:
        return None

    of_channels = np.ones(a.shape[2])
    for scale, weight in enumerate(SCALE_WEIGHTS, start=1):
        last = scale == len(SCALE_WEIGHTS)
        of_channels *= np.maximum(_ssim(a, b, peak, last), 0) ** weight
        if not last:
            a, b, peak = _halve(a, peak), _halve(b, peak), 1
    return float(of_channels.mean())


def _ssim(x: Pixels, y: Pixels, peak: int, whole: bool) -> Float64Array:
    """Mean [C] of the SSIM map, or of its contrast-structure part; in bands, which stay in the cache."""
    height, width = (side - WINDOW_SIZE + 1 for side in x.shape[:2])
    rows = max(BAND // width, 1)

    def of_band(start: int) -> Float64Array:
        band = slice(start, min(start + rows, height) + WINDOW_SIZE - 1)
        in_band = (np.multiply(plane[band], np.float32(1 / peak), dtype=np.float32) for plane in (x, y))
        return _ssim_sum(*in_band, whole=whole)

    sums: Float64Array = np.sum(in_parallel(of_band, range(0, height, rows)), axis=0)
    return np.asarray(sums / (width * height))


def _ssim_sum(x: Plane, y: Plane, *, whole: bool) -> Float64Array:
    """Sum [C] of the SSIM map, or of its contrast-structure part; in place where possible."""
    mean_x, mean_y = _window(x), _window(y)
    mean_xy = mean_x * mean_y
    energy = np.square(mean_x, out=mean_x)
    energy += np.square(mean_y, out=mean_y)
    # Only the sum of the two variances is needed, so four filters are enough instead of five.
    contrast = _window(x * y)
    contrast -= mean_xy
    contrast *= np.float32(2)
    contrast += np.float32(C2)
    variances = _window(x * x + y * y)
    variances -= energy
    variances += np.float32(C2)
    contrast /= variances
    if not whole:
        return np.asarray(contrast.sum(0, np.float64).sum(0))
    luminance = np.multiply(mean_xy, np.float32(2), out=mean_xy)
    luminance += np.float32(C1)
    energy += np.float32(C1)
    luminance /= energy
    luminance *= contrast
    return np.asarray(luminance.sum(0, np.float64).sum(0))


def _window(x: Plane) -> Plane:
    """Gaussian-weighted means over all windows inside x: [H, W, C] -> [H - 10, W - 10, C]."""
    weights = window_weights()
    margin = WINDOW_SIZE // 2
    filtered = np.asarray(cv2.sepFilter2D(x, cv2.CV_32F, weights, weights), np.float32).reshape(x.shape)
    return filtered[margin:-margin, margin:-margin]


def _halve(x: Pixels, peak: int) -> Plane:
    """Reduce to half the size by means over 2 x 2 pixels, with zeros in front of odd sides; the peak becomes 1."""
    height, width, channels = x.shape
    even: npt.NDArray[Any] = np.pad(x, ((height % 2, 0), (width % 2, 0), (0, 0))) if height % 2 or width % 2 else x
    half = np.empty((len(even) // 2, even.shape[1] // 2, channels), np.float32)
    rows = max(BAND // width, 1)

    def halve_band(start: int) -> None:
        band = np.multiply(even[2 * start : 2 * (start + rows)], np.float32(1 / peak), dtype=np.float32)
        half[start : start + rows] = halved(band)

    in_parallel(halve_band, range(0, len(half), rows))
    return half
