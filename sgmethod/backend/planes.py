"""Planes of samples at half the size."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def even(plane: NDArray[Any]) -> NDArray[Any]:
    """A plane [H, W] with both sides even: where one is odd, its last sample counts twice."""
    height, width = plane.shape
    return np.pad(plane, ((0, height % 2), (0, width % 2)), mode="edge") if height % 2 or width % 2 else plane


def halved(plane: NDArray[Any]) -> NDArray[Any]:
    """A plane [H, W] at half the size, in its own type: means of four."""
    whole = even(plane)
    height, width = whole.shape
    return np.asarray(cv2.resize(whole, (width // 2, height // 2), interpolation=cv2.INTER_AREA))
