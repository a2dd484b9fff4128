"""A whole small encode on each backend: nothing but the backend differs, and little of the result."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Backend
from sgmethod.backend.reference import Reference
from sgmethod.bitstream import container
from sgmethod.budget import Budget
from sgmethod.decoder import decode
from sgmethod.fitting.deadline import Clock, Deadline
from sgmethod.fitting.objective import Objective
from sgmethod.fitting.recorder import Recorder
from sgmethod.metrics import psnr
from sgmethod.rd.budgets import rate_of
from sgmethod.rd.encode import encode
from sgmethod.rd.request import Request
from sgmethod.settings.rd import RD, Effort
from sgmethod.settings.shared import Tune
from tests.harness.pictures import png

SIZE, BYTES = (40, 32), 400
SETTINGS = replace(RD, effort=Effort(steps=30, rounds=(0,), refine_sweeps=1, size_tries=1))


def encoded(pixels: np.ndarray, tune: Tune, backend: Backend) -> bytes:
    """The file of profile rd."""
    objective, clock = Objective.of(pixels, tune, SETTINGS.objective), Clock()
    rate = rate_of(Budget("bytes", BYTES), SIZE, SETTINGS)
    stream, steps = encode(Request(objective, rate, Deadline(clock), backend, SETTINGS, Recorder(clock)))
    assert steps >= 30
    return container.serialise(stream)


@pytest.mark.parametrize("tune", ["psnr", pytest.param("visual", marks=pytest.mark.thorough)])
def test_each_backend_makes_a_file_as_good(tune: Tune) -> None:
    pixels = np.asarray(Image.open(io.BytesIO(png(*SIZE))))
    files = [encoded(pixels, tune, backend) for backend in (Kernels(), Reference())]
    assert all(0.95 * BYTES < len(file) <= BYTES for file in files)
    of_kernels, of_reference = (psnr(decode(file), pixels) for file in files)
    assert of_reference > 29  # where the picture's mean colour alone has 16
    assert abs(of_kernels - of_reference) < 0.3  # dB; worst seen 0.22
