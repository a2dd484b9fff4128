"""Check the codec with hard pictures, extreme numbers and bad starts.

python -m benchmarks.robustness stiff [--help]       pictures that are hard to code, each rule and where it breaks
python -m benchmarks.robustness extremes [--help]    extreme Gaussians, bad starts, impossible budgets
"""

from __future__ import annotations

import sys

from benchmarks.arguments import run_part
from benchmarks.robustness import extremes, stiff

if __name__ == "__main__":
    sys.exit(run_part({"stiff": stiff.main, "extremes": extremes.main}, __doc__))
