"""Superpixels: the kernel against the module of OpenCV that it stands in for."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import sgmethod
from sgmethod.native import native
from tests.support.pictures import photo

FloatArray = NDArray[np.float32]
RANDOM = np.random.default_rng(0)
PICTURES = {
    "a photograph": photo() / np.float32(255),
    "noise": RANDOM.random((61, 90, 3), np.float32),
    "steps": np.kron(RANDOM.integers(0, 2, (20, 9, 3)), np.ones((4, 5, 1))).astype(np.float32),
    "plain": np.full((40, 33, 3), 0.3, np.float32),
    "a strip": cv2.GaussianBlur(RANDOM.random((8, 301, 3), np.float32), (0, 0), 2),
}


@pytest.mark.skipif(not hasattr(cv2, "ximgproc"), reason="this package of OpenCV has no superpixels to compare with")
@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.parametrize("threads", [1, 3])
def test_labels_are_those_of_opencv(name: str, threads: int) -> None:
    """Bit for bit, whatever the size of regions; the last has seeds beyond the picture."""
    lab = cv2.cvtColor(PICTURES[name], cv2.COLOR_RGB2LAB)
    before = native.thread_count()
    sgmethod.set_threads(threads)
    try:
        for side in (1, 2, 3, 5, 7, min(lab.shape[:2])):
            for compactness in (10.0, 0.5):
                slic = cv2.ximgproc.createSuperpixelSLIC(lab, cv2.ximgproc.SLIC, side, compactness)
                slic.iterate(10)
                slic.enforceLabelConnectivity()
                labels = native.superpixels(np.ascontiguousarray(lab.transpose(2, 0, 1)), side, compactness)
                assert np.array_equal(labels, slic.getLabels()), (side, compactness)
    finally:
        sgmethod.set_threads(before)


def test_a_region_has_a_side_within_the_picture() -> None:
    lab = np.zeros((3, 9, 12), np.float32)
    for side in (0, 10):
        with pytest.raises(ValueError, match="a region"):
            native.superpixels(lab, side, 10.0)
