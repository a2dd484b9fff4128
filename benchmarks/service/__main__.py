"""Measure the service while it encodes, under attack, and while its processes are killed.

python -m benchmarks.service load [--help]       latencies during an encode
python -m benchmarks.service attacks [--help]    other clients' latencies, and memory, under each attack
python -m benchmarks.service chaos [--help]      random kills and restarts, and what became of the jobs
"""

from __future__ import annotations

import sys

from benchmarks.arguments import run_part
from benchmarks.service import attacks, chaos, load

if __name__ == "__main__":
    sys.exit(run_part({"load": load.main, "attacks": attacks.main, "chaos": chaos.main}, __doc__))
