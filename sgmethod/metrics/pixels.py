"""PSNR and MS-SSIM of two pictures.

Both take two arrays of the same shape and type, uint8 in [0, 255] or floating point in [0, 1], and raise ValueError
otherwise. Sums are in float64; windows of MS-SSIM are in float32, which changes it by less than 1e-6.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from sgmethod.native import native
from sgmethod.numerics import quiet
from sgmethod.threads import in_parallel

Pixels = npt.NDArray[np.uint8] | npt.NDArray[np.floating[Any]]
Plane = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]

# Wang, Simoncelli and Bovik, "Multi-scale structural similarity for image quality assessment", 2003:
# section 3.2 gives the exponents of the five scales (beta_j = gamma_j, and alpha_5 equals the last).
SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
# Wang, Bovik, Sheikh and Simoncelli, "Image quality assessment", 2004, section III.B and III.C.
WINDOW_SIZE, WINDOW_SIGMA = 11, 1.5
C1, C2 = 0.01**2, 0.03**2

BLOCK = 1 << 14  # values compared at a time: few enough to stay in the cache
BAND = 1 << 16  # windows compared at a time, about

# The window must fit at the coarsest of the five scales: a side of 161 has 11 pixels there, 160 has 10.
MS_SSIM_SIDE = (WINDOW_SIZE - 1) * 2 ** (len(SCALE_WEIGHTS) - 1) + 1


@quiet
def psnr(a: Pixels, b: Pixels) -> float:
    """Peak signal-to-noise ratio in dB, over all pixels and channels together; inf for equal pictures.

    10 log10(peak^2 / mean((a - b)^2)), peak 255 for uint8 and 1 for floats. Shapes: any, equal.
    """
    peak = _peak(a, b)
    x, y = a.reshape(-1), b.reshape(-1)
    total = 0.0
    if x.dtype == np.uint8:
        total = native.squared_difference(x.view(np.uint8), y.view(np.uint8))
    else:
        for start in range(0, x.size, BLOCK):
            # Not np.dot: waking its threads would take longer than this.
            error = np.subtract(x[start : start + BLOCK], y[start : start + BLOCK], dtype=np.float64)
            total += float(np.square(error, out=error).sum())
    return math.inf if total == 0 else -10 * math.log10(total / (a.size * peak**2))


@quiet
def ms_ssim(a: Pixels, b: Pixels) -> float | None:
    """Multi-scale structural similarity of two pictures [H, W, C], mean over channels, in [0, 1].

    None if the shorter side is below MS_SSIM_SIDE = 161 pixels, where the measure is undefined. Five scales; only
    windows inside the picture; between scales means over 2 x 2 pixels, with a zero put in front of an odd side; a
    negative mean of any scale counts as 0. These are the choices of the package pytorch-msssim, whose figures are
    usually published.
    """
    peak = _peak(a, b)
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


def _peak(a: Pixels, b: Pixels) -> int:
    """Largest level of two pictures. Raises ValueError if they cannot be compared."""
    if a.shape != b.shape or a.dtype != b.dtype or a.size == 0:
        kinds = f"{a.dtype} {list(a.shape)} and {b.dtype} {list(b.shape)}"
        raise ValueError(f"pictures must have one shape and type, and pixels; got {kinds}")
    if a.dtype != np.uint8 and not np.issubdtype(a.dtype, np.floating):
        raise ValueError(f"pictures must be uint8 or floating point, got {a.dtype}")
    return 255 if a.dtype == np.uint8 else 1


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


def window_weights() -> Float64Array:
    """Weights [WINDOW_SIZE] of a Gaussian window along one axis, which sum to 1."""
    offsets = np.arange(WINDOW_SIZE) - WINDOW_SIZE // 2
    weights = np.exp(-(offsets**2) / (2 * WINDOW_SIGMA**2))
    return np.asarray(weights / weights.sum())


def _window(x: Plane) -> Plane:
    """Gaussian-weighted means over all windows inside x: [H, W, C] -> [H - 10, W - 10, C]."""
    from sgmethod.opencv import cv2  # not needed by psnr()

    weights = window_weights()
    margin = WINDOW_SIZE // 2
    filtered = np.asarray(cv2.sepFilter2D(x, cv2.CV_32F, weights, weights), np.float32).reshape(x.shape)
    return filtered[margin:-margin, margin:-margin]


def _halve(x: Pixels, peak: int) -> Plane:
    """Reduce to half the size by means over 2 x 2 pixels, with zeros in front of odd sides; the peak becomes 1."""
    from sgmethod.backend.planes import halved  # needs OpenCV, as psnr() does not

    height, width, channels = x.shape
    even: npt.NDArray[Any] = np.pad(x, ((height % 2, 0), (width % 2, 0), (0, 0))) if height % 2 or width % 2 else x
    half = np.empty((len(even) // 2, even.shape[1] // 2, channels), np.float32)
    rows = max(BAND // width, 1)

    def halve_band(start: int) -> None:
        band = np.multiply(even[2 * start : 2 * (start + rows)], np.float32(1 / peak), dtype=np.float32)
        half[start : start + rows] = halved(band)

    in_parallel(halve_band, range(0, len(half), rows))
    return half
