"""Image structure: gradients, regions and their complexity (paper, section III-B)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sgmethod.native import native
from sgmethod.opencv import cv2
from sgmethod.scene import FloatArray
from sgmethod.settings.shared import StartSettings

NARROW_PX = 8
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)


@dataclass(frozen=True)
class Structure:
    """Structure of an image.

    gradient [H, W]: Sobel magnitude of the grey image (kernel divided by 8);
    labels [H, W]: region of each pixel, 0 .. regions - 1;
    complexity [regions]: variance of the gradient magnitude within each region;
    area [regions]: pixels of each region;
    tensor [H, W, 3]: smoothed structure tensor (xx, xy, yy) of the grey image.
    """

    gradient: FloatArray
    labels: NDArray[np.int32]
    complexity: FloatArray
    area: NDArray[np.int64]
    tensor: FloatArray


def analyse(image: FloatArray, regions: int, settings: StartSettings) -> Structure:
    """Analyse the structure of an image [H, W, 3] in [0, 1]. regions: number of superpixels requested from SLIC."""
    grey = np.einsum("ijk,k->ij", image, _LUMA)  # not @: rounding would depend on the processor
    gx = cv2.Sobel(grey, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8, borderType=cv2.BORDER_REPLICATE)
    gy = cv2.Sobel(grey, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8, borderType=cv2.BORDER_REPLICATE)
    gradient = np.hypot(gx, gy).astype(np.float32)
    labels = (_slic if settings.superpixels == "skimage" else _opencv_slic)(image, regions, settings.compactness)
    _, flat = np.unique(labels, return_inverse=True)
    flat = flat.reshape(-1)
    area = np.bincount(flat)
    mean = np.bincount(flat, gradient.ravel()) / area
    square = np.bincount(flat, gradient.ravel().astype(np.float64) ** 2) / area
    tensor = cv2.GaussianBlur(np.stack([gx * gx, gx * gy, gy * gy], -1), (0, 0), settings.tensor_smoothing_px)
    return Structure(
        gradient,
        np.asarray(flat.reshape(image.shape[:2]), np.int32),
        np.maximum(square - mean**2, 0).astype(np.float32),
        area,
        tensor.astype(np.float32),
    )


def _slic(image: FloatArray, regions: int, compactness: float) -> NDArray[np.int32]:
    from skimage.segmentation import slic  # takes 0.3 s to import

    labels = slic(image, n_segments=regions, compactness=compactness, start_label=0, channel_axis=-1)
    return np.asarray(labels, np.int32)


def _opencv_slic(image: FloatArray, regions: int, compactness: float) -> NDArray[np.int32]:
    """Superpixels as in OpenCV's contrib module. A narrow picture becomes one region: it has no room for seeds."""
    height, width = image.shape[:2]
    if min(height, width) < NARROW_PX:
        return np.zeros((height, width), np.int32)
    side = min(round(math.sqrt(height * width / regions)), height, width)
    lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB)
    return native.superpixels(np.ascontiguousarray(lab.transpose(2, 0, 1)), max(side, 1), compactness)
