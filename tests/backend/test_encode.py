"""A whole small encode on each backend: nothing but the backend differs, and little of the result."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Backend
from sgmethod.bitstream import container
from sgmethod.budget import Budget
from sgmethod.decoder import decode
from sgmethod.metrics import psnr
from sgmethod.settings.rd import RD, Effort
from sgmethod.settings.shared import Tune
from sgmethod.view import View
from tests.definitions.backend import Reference
from tests.rd.short import asked
from tests.support.pictures import png

SIZE, BYTES = (40, 32), 400
SETTINGS = replace(RD, effort=Effort(steps=30, rounds=(0,), refine_sweeps=1, size_tries=1))


def encoded(pixels: np.ndarray, tune: Tune, backend: Backend) -> bytes:
    """The file of profile rd."""
    stream, steps = asked(pixels, Budget("bytes", BYTES), tune, settings=SETTINGS, backend=backend).encode()
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
