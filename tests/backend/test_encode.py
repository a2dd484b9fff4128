"""A whole small encode on each backend: nothing but the backend differs, and little of the result; names of devices."""

from __future__ import annotations

import io
import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

import sgmethod
from sgmethod.backend.devices import backend_on
from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Backend
from sgmethod.backend.tensors import Tensors
from sgmethod.bitstream import container
from sgmethod.budget import Budget
from sgmethod.decoder import decode
from sgmethod.metrics import psnr
from sgmethod.rd.encode import encode
from sgmethod.settings.rd import RD, Effort
from sgmethod.settings.shared import Tune
from sgmethod.view import View
from tests.definitions.backend import Reference
from tests.rd.short import requested
from tests.support.pictures import photo, png

SIZE, BYTES = (40, 32), 400
SETTINGS = replace(RD, effort=Effort(steps=30, rounds=(0,), refine_sweeps=1, size_tries=1))


def encoded(pixels: np.ndarray, tune: Tune, backend: Backend) -> bytes:
    """The file of profile rd."""
    stream, steps = encode(requested(pixels, Budget("bytes", BYTES), tune, settings=SETTINGS, backend=backend))
    assert steps >= 30
    return container.serialise(stream)


@pytest.mark.parametrize("tune", ["psnr", pytest.param("visual", marks=pytest.mark.thorough)])
def test_each_backend_makes_a_file_as_good(tune: Tune) -> None:
    pixels = np.asarray(Image.open(io.BytesIO(png(*SIZE))))
    files = [encoded(pixels, tune, backend) for backend in (Kernels(), Reference())]
    assert all(0.95 * BYTES < len(file) <= BYTES for file in files)
    # Without noise, which is the same on all backends, and no part of what they fit.
    of_kernels, of_reference = (psnr(decode(file, view=View(texture=False)), pixels) for file in files)
    assert of_reference > 29  # where the picture's mean colour alone has 16
    assert abs(of_kernels - of_reference) < 0.3  # dB; worst seen 0.22


def test_files_are_as_good_as_those_of_the_kernels() -> None:
    """Slow: nine encodes on tensors. On average: fits with other last bits end a tenth of a dB apart."""
    gains = []
    for x, y in itertools.product((0, 40, 80), (0, 32, 64)):
        pixels = photo()[y : y + SIZE[1], x : x + SIZE[0]]
        files = [encoded(pixels, "psnr", backend) for backend in (Kernels(), Tensors(torch.device("cpu")))]
        assert all(0.95 * BYTES < len(file) <= BYTES for file in files)
        of_kernels, of_tensors = (psnr(decode(file), pixels) for file in files)
        gains.append(of_tensors - of_kernels)
    assert np.mean(gains) > -0.1  # dB; seen: -0.01 with a standard error of 0.04, and -0.19 to 0.17 each


def test_devices() -> None:
    assert type(backend_on(None)) is type(backend_on("cpu")) is Kernels
    assert type(backend_on("cpu:0")) is Tensors
    for name in ("gpu", "cuda:99", "mps" if torch.cuda.is_available() else "cuda", "meta", "", 7):
        with pytest.raises(sgmethod.SgError, match=r"^there is no device '.*' here: [^\n]+$"):
            backend_on(name)
