"""How close two pictures are: PSNR and MS-SSIM.

Both take two arrays of the same shape and type, uint8 in [0, 255] or floating point in [0, 1], and raise
ValueError otherwise. Both compute in float64 on the scale [0, 1].
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

Pixels = npt.NDArray[np.uint8] | npt.NDArray[np.floating[Any]]
Float64Array = npt.NDArray[np.float64]

# Wang, Simoncelli and Bovik, "Multi-scale structural similarity for image quality assessment", 2003:
# section 3.2 gives the exponents of the five scales (beta_j = gamma_j, the last with alpha_5).
SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
# Wang, Bovik, Sheikh and Simoncelli, "Image quality assessment", 2004, section III.B and III.C.
WINDOW_SIZE, WINDOW_SIGMA = 11, 1.5
C1, C2 = 0.01**2, 0.03**2

# The window must fit at the coarsest of the five scales: a side of 161 has 11 pixels there, 160 has 10.
MIN_SIDE = (WINDOW_SIZE - 1) * 2 ** (len(SCALE_WEIGHTS) - 1) + 1


def psnr(a: Pixels, b: Pixels) -> float:
    """Peak signal-to-noise ratio in dB, over all pixels and channels together; inf for equal pictures.

    10 log10(peak^2 / mean((a - b)^2)), peak 255 for uint8 and 1 for floats. Shapes: any, equal.
    """
    x, y = _unit_scale(a, b)
    error = float(np.mean(np.square(x - y)))
    return math.inf if error == 0 else -10 * math.log10(error)


def ms_ssim(a: Pixels, b: Pixels) -> float | None:
    """Multi-scale structural similarity of two pictures [H, W, C], mean over channels, in [0, 1].

    None if the shorter side is under MIN_SIDE = 161 pixels, where the measure is not defined. Five scales;
    windows that fit the picture only; between scales a mean over 2 x 2 pixels, an odd side being led by one
    zero; a negative mean of any scale counts as 0. These are the choices of the package pytorch-msssim, whose
    numbers are the ones usually published.
    """
    x, y = _unit_scale(a, b)
    if x.ndim != 3:
        raise ValueError(f"pictures must be [H, W, C], got {list(x.shape)}")
    if min(x.shape[:2]) < MIN_SIDE:
        return None
    product = np.ones(x.shape[2])
    for scale, weight in enumerate(SCALE_WEIGHTS, start=1):
        similarity, contrast = _ssim(x, y)
        last = scale == len(SCALE_WEIGHTS)
        product *= np.maximum(similarity if last else contrast, 0) ** weight
        if not last:
            x, y = _halve(x), _halve(y)
    return float(product.mean())


def _unit_scale(a: Pixels, b: Pixels) -> tuple[Float64Array, Float64Array]:
    if a.shape != b.shape or a.dtype != b.dtype or a.size == 0:
        kinds = f"{a.dtype} {list(a.shape)} and {b.dtype} {list(b.shape)}"
        raise ValueError(f"pictures must have one shape and type, and pixels; got {kinds}")
    if a.dtype != np.uint8 and not np.issubdtype(a.dtype, np.floating):
        raise ValueError(f"pictures must be uint8 or floating point, got {a.dtype}")
    peak = 255 if a.dtype == np.uint8 else 1
    return a.astype(np.float64) / peak, b.astype(np.float64) / peak


def _ssim(x: Float64Array, y: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Per channel, [C]: the means of the SSIM map and of its contrast-structure part."""
    mean_x, mean_y = _window(x), _window(y)
    mean_xy = mean_x * mean_y
    energy = mean_x * mean_x + mean_y * mean_y
    # The two variances are only ever added, so four filters do instead of five.
    variances = _window(x * x + y * y) - energy
    covariance = _window(x * y) - mean_xy
    contrast = (2 * covariance + C2) / (variances + C2)
    luminance = (2 * mean_xy + C1) / (energy + C1)
    return (luminance * contrast).mean(axis=(0, 1)), contrast.mean(axis=(0, 1))


def _window(x: Float64Array) -> Float64Array:
    """Gaussian-weighted means over all windows inside x: [H, W, C] -> [H - 10, W - 10, C]."""
    import cv2  # belongs to the extra "encode"; psnr does without

    offsets = np.arange(WINDOW_SIZE) - WINDOW_SIZE // 2
    weights = np.exp(-(offsets**2) / (2 * WINDOW_SIGMA**2))
    weights /= weights.sum()
    margin = WINDOW_SIZE // 2
    filtered = np.asarray(cv2.sepFilter2D(x, cv2.CV_64F, weights, weights), dtype=np.float64)
    return filtered.reshape(x.shape)[margin:-margin, margin:-margin]


def _halve(x: Float64Array) -> Float64Array:
    """Means over 2 x 2 pixels, after a row or column of zeros in front where a side is odd."""
    height, width, _ = x.shape
    if height % 2 or width % 2:
        x = np.pad(x, ((height % 2, 0), (width % 2, 0), (0, 0)))
    return (x[0::2, 0::2] + x[1::2, 0::2] + x[0::2, 1::2] + x[1::2, 1::2]) / 4
