"""Decodes every golden file and many damaged copies of them, in a process whose kernels are built with sanitizers.

python -m tests.native.sanitize.mutations COUNT SEED. A sanitizer ends the process at what it finds; the input then lies
in input.sg. At the end the kernels must have lost no memory.
"""

from __future__ import annotations

import ctypes
import os
import random
import sys
from collections import Counter
from pathlib import Path

from sgmethod import BitstreamError, View, ViewError, decode
from sgmethod.native import native
from tests.native.harness.golden import GOLDEN, is_golden
from tests.support.data import with_checksum

MAX_PIXELS = 1 << 16  # a header can claim 4 gigapixels
NUMBERS = (0, 1, 2, 15, 16, 17, 127, 128, 254, 255)
INPUT = Path("input.sg")


def mutated(data: bytes, rng: random.Random) -> bytes:
    """One to four changes; many of them near the beginning, where the headers are."""
    changed = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(min(len(changed), rng.choice((24, 200, 1 << 30, 1 << 30)))) if changed else 0
        length = rng.choice((1, 1, 2, 4, 16, 300))
        kind = rng.randrange(7)
        if kind == 0:
            changed[at : at + 1] = bytes(byte ^ 1 << rng.randrange(8) for byte in changed[at : at + 1])
        elif kind == 1:
            changed[at : at + length] = rng.randbytes(length)
        elif kind == 2:
            changed[at : at + length] = bytes(rng.choice(NUMBERS) for _ in range(length))
        elif kind == 3:
            del changed[at : at + length]
        elif kind == 4:
            changed[at:at] = changed[at : at + length] * rng.choice((1, 1, 100))
        elif kind == 5:
            del changed[rng.randrange(len(changed) + 1) :]
        else:
            other = rng.choice(list(GOLDEN.values()))
            changed[at:] = other[rng.randrange(len(other)) :]
    return bytes(changed)


def outcome(data: bytes, view: View) -> str:
    """How a decode ends. INPUT holds the data for as long as it runs."""
    INPUT.write_bytes(data)
    try:
        decode(data, MAX_PIXELS, view)
    except (BitstreamError, ViewError) as error:
        return type(error).__name__
    finally:
        INPUT.unlink()
    return "pixels"


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
    rng = random.Random(seed)
    ends: Counter[str] = Counter()
    for number in range(count):
        data = mutated(rng.choice(list(GOLDEN.values())), rng)
        if number % 2:
            data = with_checksum(data)
        region = rng.choice((None, None, (1, 2, 5, 4)))
        view = View(rng.choice((1.0, 1.0, 0.3, 2.5)), region, rng.choice((1.0, 1.0, rng.uniform(0.01, 1))))
        ends[outcome(data, view)] += 1
    for name, data in GOLDEN.items():
        assert is_golden(name, decode(data)), f"{name} decodes to other pixels after all"
    if lost := leaks():
        sys.exit(lost)
    print(f"{len(GOLDEN)} golden files right; {count} mutations of seed {seed}: {dict(ends)}", flush=True)


if __name__ == "__main__":
    main()
