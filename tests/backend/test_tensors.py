"""The backend on tensors, on the CPU, against the reference: as the kernels are compared in test_drawing.py."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from PIL import Image

import sgmethod
from sgmethod.backend.devices import backend_on
from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Frame
from sgmethod.backend.reference import Reference
from sgmethod.backend.tensors import Tensors
from sgmethod.metrics import psnr
from tests.backend.cases import FRAMES, VISIBILITIES, image, over, target, visibility, worst
from tests.backend.test_encode import BYTES, SIZE, encoded
from tests.harness.data import PHOTOGRAPHS

TENSORS, REFERENCE = Tensors(torch.device("cpu")), Reference()

every_frame = pytest.mark.parametrize("frame", FRAMES.values(), ids=FRAMES)
every_visibility = pytest.mark.parametrize("kind", VISIBILITIES)


@every_frame
def test_residual(frame: Frame) -> None:
    gaussians, wanted = over(frame, 0), target(0)
    for first, end in ((0, frame.height), (13, 30)):
        found = [backend.residual(gaussians, frame, wanted[:, first:end], first) for backend in (TENSORS, REFERENCE)]
        assert worst(*found) < 1e-5  # worst seen 1.6e-7


@every_visibility
@every_frame
def test_error_and_gradients(frame: Frame, kind: str) -> None:
    asked = over(frame, 1), frame, target(1), visibility(kind, 1)
    error, gradient = TENSORS.gradients(*asked)
    wanted_error, wanted = REFERENCE.gradients(*asked)
    assert error == pytest.approx(wanted_error, rel=3e-6)
    assert TENSORS.error(*asked) == pytest.approx(wanted_error, rel=3e-6)
    for by, wanted_by in zip(gradient.arrays, wanted.arrays, strict=True):
        assert worst(by, wanted_by) < 1e-5
    assert worst(TENSORS.gram(*asked[:2], asked[3]), REFERENCE.gram(*asked[:2], asked[3])) < 1e-5


@every_frame
def test_regularised(frame: Frame) -> None:
    losses = [backend.regularised(frame, image(0), 0.06) for backend in (TENSORS, REFERENCE)]
    with torch.no_grad():  # as profile paper calls it
        mse, gradient = losses[0](over(frame, 0))
    wanted_mse, wanted = losses[1](over(frame, 0))
    assert mse == pytest.approx(wanted_mse, rel=3e-6)
    for by, wanted_by in zip(gradient.arrays, wanted.arrays, strict=True):
        assert worst(by, wanted_by) < 1e-5


def test_files_are_as_good_as_those_of_the_kernels() -> None:
    """On average: a fit that begins with other last bits ends some hundredths of a decibel higher or lower."""
    photo, gains = np.asarray(Image.open(PHOTOGRAPHS / "kodim23-crop.png").convert("RGB")), []
    for x, y in ((0, 0), (40, 0), (80, 0), (0, 32)):
        pixels = np.ascontiguousarray(photo[y : y + SIZE[1], x : x + SIZE[0]])
        files = [encoded(pixels, "psnr", backend) for backend in (Kernels(), TENSORS)]
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
