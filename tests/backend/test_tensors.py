"""The backend on tensors, on the CPU: whole files, and names of devices. Its values: test_drawing.py."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from PIL import Image

import sgmethod
from sgmethod.backend.devices import backend_on
from sgmethod.backend.kernels import Kernels
from sgmethod.backend.tensors import Tensors
from sgmethod.metrics import psnr
from tests.backend.test_encode import BYTES, SIZE, encoded
from tests.harness.data import PHOTOGRAPHS


def test_files_are_as_good_as_those_of_the_kernels() -> None:
    """On average: a fit that begins with other last bits ends some hundredths of a decibel higher or lower."""
    photo, gains = np.asarray(Image.open(PHOTOGRAPHS / "kodim23-crop.png").convert("RGB")), []
    for x, y in ((0, 0), (40, 0), (80, 0), (0, 32)):
        pixels = np.ascontiguousarray(photo[y : y + SIZE[1], x : x + SIZE[0]])
        files = [encoded(pixels, "psnr", backend) for backend in (Kernels(), Tensors(torch.device("cpu")))]
        assert all(0.95 * BYTES < len(file) <= BYTES for file in files)
        of_kernels, of_tensors = (psnr(sgmethod.decode(file), pixels) for file in files)
        gains.append(of_tensors - of_kernels)
    assert np.mean(gains) > -0.05  # dB; seen: 0.006, and -0.08 to 0.07 each


def test_devices() -> None:
    assert type(backend_on(None)) is type(backend_on("cpu")) is Kernels
    assert type(backend_on("cpu:0")) is Tensors
    for name in ("gpu", "cuda:99", "mps" if torch.cuda.is_available() else "cuda", "meta", "", 7):
        with pytest.raises(sgmethod.SgError, match=r"^there is no device '.*' here: [^\n]+$"):
            sgmethod.encode(np.zeros((8, 8), np.uint8), device=name)
