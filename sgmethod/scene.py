"""The set of Gaussians, in plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]


@dataclass(frozen=True)
class Gaussians:
    """N Gaussians over a picture; what the renderer draws.

    means [N, 2]: centres (x, y) in pixels, the first pixel's centre at (0.5, 0.5);
    factors [N, 3]: (l1, l2, l3) in pixels of the lower triangular L, covariance = L L^T;
    colors [N, 3]: signed RGB weights, 1 being full white.
    """

    means: FloatArray
    factors: FloatArray
    colors: FloatArray

    def __len__(self) -> int:
        return len(self.means)
