"""Decodes every golden file and many damaged copies of them, in a process whose kernels are built with sanitizers.

python -m tests.native.sanitize.mutations COUNT SEED. A sanitizer ends the process at what it finds; the input then lies
in input.sg. At the end the kernels must have lost no memory.
"""

from __future__ import annotations

import ctypes
import math
import os
import sys
from pathlib import Path

from sgmethod import decode
from sgmethod.native import native
from tests.bitstream.mutations import explore
from tests.native.harness.golden import GOLDEN, is_golden


def leaks() -> str:
    """What the leak sanitizer says of memory that the kernels lost.

    Python and numpy keep much to the end that looks like leaks, as does the module for its functions. So this looks for
    reports of the kernels alone.
    """
    sanitizer, path = ctypes.CDLL(None), Path(f"leaks.{os.getpid()}")
    sanitizer.__sanitizer_set_report_path(b"leaks")
    sanitizer.__lsan_do_recoverable_leak_check()
    sanitizer.__sanitizer_set_report_path(b"stderr")
    reports = path.read_text().split("\n\n") if path.exists() else []
    path.unlink(missing_ok=True)
    module = "nanobind__native_exec"
    return "\n\n".join(r for r in reports if "leak of" in r and "_native" in r and module not in r)


def main() -> None:
    count, seed = map(int, sys.argv[1:])
    for name, data in GOLDEN.items():
        for threads in (1, 3):
            native.set_thread_count(threads)
            assert is_golden(name, decode(data)), f"{name} decodes to other pixels"
    ends = explore(count, seed, Path("input.sg"), math.inf)  # sanitizers multiply the time
    for name, data in GOLDEN.items():
        assert is_golden(name, decode(data)), f"{name} decodes to other pixels after all"
    if lost := leaks():
        sys.exit(lost)
    print(f"{len(GOLDEN)} golden files right; {count} mutations of seed {seed}: {dict(ends)}", flush=True)


if __name__ == "__main__":
    main()
