"""How the service answers while it encodes, while some clients mean harm, and while processes are killed.

python -m benchmarks.service load [--help]       latencies beside an encode that takes every core
python -m benchmarks.service attacks [--help]    other clients' latencies, and memory, under each attack
python -m benchmarks.service chaos [--help]      kills and restarts at random, and the ledger of jobs after them
"""

from __future__ import annotations

import sys

from benchmarks.arguments import run_part
from benchmarks.service import attacks, chaos, load

if __name__ == "__main__":
    sys.exit(run_part({"load": load.main, "attacks": attacks.main, "chaos": chaos.main}, __doc__))
