"""Image structure: gradients, regions and their complexity (paper, section III-B)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sgmethod.scene import FloatArray

_LUMA = np.array([0.299, 0.587, 0.114], np.float32)


@dataclass(frozen=True)
class Structure:
    """What the image says about where detail is.

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


def analyse(image: FloatArray, regions: int, compactness: float, smoothing: float) -> Structure:
    """Structure of an image [H, W, 3] in [0, 1].

    regions: superpixels asked of SLIC; compactness: its balance of distance and colour;
    smoothing: standard deviation in pixels of the structure tensor's window.
    """
    from skimage.segmentation import slic  # a third of a second that profile rd has no use for

    grey = image @ _LUMA
    gx = cv2.Sobel(grey, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8, borderType=cv2.BORDER_REPLICATE)
    gy = cv2.Sobel(grey, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8, borderType=cv2.BORDER_REPLICATE)
    gradient = np.hypot(gx, gy).astype(np.float32)
    labels = slic(image, n_segments=regions, compactness=compactness, start_label=0, channel_axis=-1)
    _, flat = np.unique(labels, return_inverse=True)
    flat = flat.reshape(-1).astype(np.int32)
    area = np.bincount(flat)
    mean = np.bincount(flat, gradient.ravel()) / area
    square = np.bincount(flat, gradient.ravel().astype(np.float64) ** 2) / area
    tensor = cv2.GaussianBlur(np.stack([gx * gx, gx * gy, gy * gy], -1), (0, 0), smoothing)
    return Structure(
        gradient,
        flat.reshape(labels.shape),
        np.maximum(square - mean**2, 0).astype(np.float32),
        area,
        tensor.astype(np.float32),
    )
