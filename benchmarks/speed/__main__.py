"""Time of the kernels alone, and of encodes by pixels and bytes.

python -m benchmarks.speed kernels [--help]   drawing and its gradients, by instruction set and number of threads
python -m benchmarks.speed growth [--help]    seconds by megapixels for fixed bytes and the other way, beside AVIF
"""

from __future__ import annotations

import sys

from benchmarks.arguments import run_part
from benchmarks.speed import growth, kernels

if __name__ == "__main__":
    sys.exit(run_part({"kernels": kernels.main, "growth": growth.main}, __doc__))
