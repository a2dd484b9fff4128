"""Image structure: gradients, regions and their complexity (paper, section III-B)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skimage.segmentation import slic

from sgmethod.opencv import cv2
from sgmethod.paper.settings import StartSettings
from sgmethod.scene import FloatArray

_LUMA = np.array([0.299, 0.587, 0.114], np.float32)


@dataclass(frozen=True)
class Structure:
    """Structure of an image.

    gradient [H, W]: Sobel magnitude of the grey image (kernel divided by 8);
    labels [H, W]: region of each pixel, 0 .. regions - 1;
    complexity [regions]: variance of the gradient magnitude within each region;
    area [regions]: pixels of each region.
    """

    gradient: FloatArray
    labels: NDArray[np.int32]
    complexity: FloatArray
    area: NDArray[np.int64]


def analyse(image: FloatArray, regions: int, settings: StartSettings) -> Structure:
    """Analyse the structure of an image [H, W, 3] in [0, 1]. regions: number of superpixels requested from SLIC."""
    grey = np.einsum("ijk,k->ij", image, _LUMA)  # not @: rounding would depend on the processor
    gx = cv2.Sobel(grey, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8, borderType=cv2.BORDER_REPLICATE)
    gy = cv2.Sobel(grey, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8, borderType=cv2.BORDER_REPLICATE)
    gradient = np.hypot(gx, gy).astype(np.float32)
    labels = _slic(image, regions, settings.compactness)
    _, flat = np.unique(labels, return_inverse=True)
    flat = flat.reshape(-1)
    area = np.bincount(flat)
    mean = np.bincount(flat, gradient.ravel()) / area
    square = np.bincount(flat, gradient.ravel().astype(np.float64) ** 2) / area
    return Structure(
        gradient,
        np.asarray(flat.reshape(image.shape[:2]), np.int32),
        np.maximum(square - mean**2, 0).astype(np.float32),
        area,
    )


def _slic(image: FloatArray, regions: int, compactness: float) -> NDArray[np.int32]:
    labels = slic(image, n_segments=regions, compactness=compactness, start_label=0, channel_axis=-1)
    return np.asarray(labels, np.int32)
