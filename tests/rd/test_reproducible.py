"""Files are the same, whichever kernels the linear algebra behind NumPy chooses."""

import os
import subprocess
import sys

ENCODE = """
import sys, sgmethod
from skimage import data
pixels = data.astronaut()[40:140, 140:260]
for tune in ("psnr", "visual"):
    sys.stdout.buffer.write(sgmethod.encode(pixels, bpp=0.4, tune=tune).data)
"""


def test_files_do_not_depend_on_kernels_of_openblas() -> None:
    """Those for AVX-512 round otherwise than the others, so a processor with it shows most."""

    def files_with(kernels: dict[str, str]) -> bytes:
        environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_CORETYPE"}
        command = [sys.executable, "-c", ENCODE]
        return subprocess.run(command, env=environment | kernels, check=True, capture_output=True).stdout

    assert files_with({}) == files_with({"OPENBLAS_CORETYPE": "Prescott"})
