"""PSNR of two pictures."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from sgmethod.native import native
from sgmethod.numerics import quiet

Pixels = npt.NDArray[np.uint8] | npt.NDArray[np.floating[Any]]

BLOCK = 1 << 14  # values compared at a time: few enough to stay in the cache


@quiet
def psnr(a: Pixels, b: Pixels) -> float:
    """Peak signal-to-noise ratio in dB, over all pixels and channels together; inf for equal pictures.

    10 log10(peak^2 / mean((a - b)^2)), peak 255 for uint8 and 1 for floats. Shapes: any, equal.
    """
    peak = peak_of(a, b)
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


def peak_of(a: Pixels, b: Pixels) -> int:
    """Largest level of two pictures. Raises ValueError if they cannot be compared."""
    if a.shape != b.shape or a.dtype != b.dtype or a.size == 0:
        kinds = f"{a.dtype} {list(a.shape)} and {b.dtype} {list(b.shape)}"
        raise ValueError(f"pictures must have one shape and type, and pixels; got {kinds}")
    if a.dtype != np.uint8 and not np.issubdtype(a.dtype, np.floating):
        raise ValueError(f"pictures must be uint8 or floating point, got {a.dtype}")
    return 255 if a.dtype == np.uint8 else 1
