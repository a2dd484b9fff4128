"""Gaussians from a caller's arrays, checked."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from sgmethod.errors import GaussiansError
from sgmethod.numerics import quiet
from sgmethod.scene import Gaussians, readable

Number = TypeVar("Number", np.float32, np.float64)


def checked_gaussians(gaussians: Gaussians) -> Gaussians:
    """Convert NumPy arrays, tensors of any device or nested lists to C-contiguous float32 arrays.

    Raises GaussiansError for other shapes than [N, 2], [N, 3] and [N, 3], values that are not finite, and shapes that
    are not ellipses.
    """
    if not isinstance(gaussians, Gaussians):
        raise GaussiansError(f"Gaussians must be a sgmethod.Gaussians, not {type(gaussians).__name__}")
    own = Gaussians(*(checked_array(values, np.float32) for values in gaussians.arrays))
    shapes, n = [values.shape for values in own.arrays], len(own.means) if own.means.ndim else 0
    if shapes != [(n, 2), (n, 3), (n, 3)]:
        raise GaussiansError(f"means [N, 2], factors [N, 3] and colours [N, 3] are needed, not {shapes}")
    finite = np.isfinite(np.concatenate(own.arrays, 1)).all(1)
    if not finite.all():
        raise GaussiansError(f"Gaussian {finite.argmin()} has a value that is not finite")
    positive = (own.factors[:, ::2] > 0).all(1)
    if not positive.all():
        raise GaussiansError(f"Gaussian {positive.argmin()} is not an ellipse: l1 and l3 must be positive")
    return own


@quiet
def checked_array(values: Any, kind: type[Number]) -> NDArray[Number]:
    """Convert a NumPy array, a tensor of any device or nested lists to a C-contiguous array. Raises GaussiansError."""
    try:
        return np.ascontiguousarray(readable(values), kind)
    except (TypeError, ValueError, OverflowError) as error:
        raise GaussiansError(f"{type(values).__name__} is not an array of numbers") from error
