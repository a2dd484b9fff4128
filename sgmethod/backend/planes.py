"""Planes of samples: reduced to half the size, and blurred."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sgmethod.native import native
from sgmethod.opencv import cv2
from sgmethod.scene import FloatArray

Beyond = Literal["edge", "constant"]


def even(plane: NDArray[Any], beyond: Beyond = "edge") -> NDArray[Any]:
    """Pad a plane [H, W], or [H, W, C], to even sides, by repeating the last sample or by zeros."""
    height, width = plane.shape[:2]
    more = (0, height % 2), (0, width % 2), *[(0, 0)] * (plane.ndim - 2)
    return np.pad(plane, more, mode=beyond) if height % 2 or width % 2 else plane


def halved(plane: NDArray[Any], beyond: Beyond = "edge") -> NDArray[Any]:
    """Reduce a plane [H, W], or [H, W, C], to half the size, by means of four samples in its own type.

    beyond: see even().
    """
    whole = even(plane, beyond)
    height, width = (side // 2 for side in whole.shape[:2])
    half = np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))
    return half.reshape(height, width, *plane.shape[2:])  # OpenCV leaves out a single channel


def all_halved(planes: NDArray[Any]) -> NDArray[Any]:
    """Reduce planes [N, H, W] to half the size."""
    return np.stack([halved(plane) for plane in planes])


def gains(planes: list[FloatArray], sigmas: FloatArray, scales: FloatArray) -> tuple[FloatArray, NDArray[np.uint8]]:
    """Largest of scales [N] times the sum of squares of planes [3][H, W] blurred by sigmas [N], and its number."""
    gain, chosen = np.empty(planes[0].shape, np.float32), np.empty(planes[0].shape, np.uint8)
    native.gains(planes[0], planes[1], planes[2], sigmas, scales, gain, chosen)
    return gain, chosen
