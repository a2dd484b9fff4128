"""Files are the same for every number of threads, however long a step takes, and whatever NumPy's kernels are."""

import os
import subprocess
import sys
from typing import Any

import cv2
import numpy as np
import pytest

from sgmethod import encode, set_threads
from sgmethod.fitting import deadline
from sgmethod.native import native
from sgmethod.scene import Pixels
from tests.support.pictures import photo

ENCODE = """
import sys, sgmethod
from skimage import data
pixels = data.astronaut()[40:140, 140:260]
for tune in ("psnr", "visual"):
    sys.stdout.buffer.write(sgmethod.encode(pixels, bpp=0.4, tune=tune).data)
"""


FIT = """
import sys
from sgmethod.budget import Budget
from tests.rd.test_effort import fitted
for array in fitted(Budget("bytes", 600), "visual").state.gaussians.arrays:
    sys.stdout.buffer.write(array.tobytes())
"""


def files_with(variables: dict[str, str], script: str = ENCODE) -> bytes:
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_CORETYPE"}
    command = [sys.executable, "-c", script]
    return subprocess.run(command, env=environment | variables, check=True, capture_output=True).stdout


def test_files_do_not_depend_on_kernels_of_openblas() -> None:
    """Those for AVX-512 round otherwise than the others, so a processor with it shows most."""
    assert files_with({}) == files_with({"OPENBLAS_CORETYPE": "Prescott"})


def test_fits_do_not_depend_on_what_memory_held() -> None:
    """The GNU C library fills memory with a byte before it hands it out. Once, a fit became NaN."""
    assert files_with({}, FIT) == files_with({"MALLOC_PERTURB_": "1"}, FIT)


def page() -> Pixels:
    """A word on white, which is fitted as islands."""
    pixels = np.full((600, 500, 3), 255, np.uint8)
    cv2.putText(pixels, "islands", (90, 320), cv2.FONT_HERSHEY_SIMPLEX, 1, (0, 30, 60), 2)
    return pixels


@pytest.mark.parametrize(
    ("pixels", "options"),
    [
        pytest.param(cv2.resize(photo(), (211, 173)), {"bpp": 0.5, "effort": 3}, id="visual"),
        pytest.param(cv2.resize(photo(), (211, 173)), {"bpp": 0.5, "effort": 3, "tune": "psnr"}, id="psnr"),
        pytest.param(page(), {"bytes": 400, "effort": 3}, id="islands"),
    ],
)
def test_files_do_not_depend_on_threads_or_time(
    pixels: Pixels, options: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Strips of a picture are as many as threads; steps taken together are as many as fit a part of a second."""
    before, files = native.thread_count(), set()
    try:
        for threads, steps_s in ((1, 0.05), (2, 0.0), (5, 1.0)):
            set_threads(threads)
            monkeypatch.setattr(deadline, "STEPS_S", steps_s)
            files.add(encode(pixels, **options).data)
    finally:
        set_threads(before)
    assert len(files) == 1
