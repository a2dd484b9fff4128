"""Check the codec with hard pictures, extreme numbers and bad starts.

python -m benchmarks.robustness stiff [--help]       pictures that are hard to code, each rule and where it breaks
python -m benchmarks.robustness extremes [--help]    extreme Gaussians, bad starts, impossible budgets
python -m benchmarks.robustness order [--help]       photographs: more time or more bytes, and a worse file
"""

from __future__ import annotations

import sys

from benchmarks.arguments import run_part
from benchmarks.robustness import extremes, order, stiff

if __name__ == "__main__":
    sys.exit(run_part({"stiff": stiff.main, "extremes": extremes.main, "order": order.main}, __doc__))
