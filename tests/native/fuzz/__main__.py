"""Fuzzes the entropy decoder and the drawing with a new random seed: python -m tests.native.fuzz [--minutes N].

Clang builds the target, entropy.cpp, with the sanitizers of addresses and of undefined behaviour. New finds go to
build/fuzz/found/. An input that fails is kept, and the command that repeats it printed: python -m tests.native.fuzz
--repeat FILE.
"""

from __future__ import annotations

import argparse
import random
import shutil
import struct
import subprocess
import sys
from pathlib import Path

from sgmethod.bitstream import container
from sgmethod.bitstream.v2 import StreamV2, quantum_code
from tests.bitstream.mutations import CORPUS
from tests.native.harness.build import BUILDS, PATH, build
from tests.support.data import SIGNATURE

FORMER = Path(__file__).parent / "corpus" / "entropy"  # what was found once
FOUND = BUILDS / "fuzz" / "found"
CLANG = {"CC": "clang", "CXX": "clang++"}
# Limits of time and memory for one input; sanitizers multiply both.
LIMITS = ("-timeout=20", "-rss_limit_mb=4096", "-max_len=4096")


def bare(data: bytes) -> bytes:
    """A file of version 2 as entropy.cpp takes it."""
    stream = container.parse(data)
    assert isinstance(stream, StreamV2)
    code = quantum_code(stream.quantum)
    flags = stream.grey | stream.upright << 1 | (stream.texture is not None) << 4 | stream.is_short << 5
    size = stream.width, stream.height
    return struct.pack(">HHBBB", *size, 13 - (code >> 8), code & 255, flags) + stream.payload


def fuzz(program: Path, minutes: float) -> int:
    """The exit status of the target after its time, or at a failure."""
    seed = random.SystemRandom().randrange(1, 2**31)
    print(f"--- {minutes:g} minutes with seed {seed}", flush=True)
    found, begin = FOUND / "entropy", FOUND / "begin"
    for folder in (found, begin):
        folder.mkdir(parents=True, exist_ok=True)
    for number, data in enumerate(CORPUS):
        if data.startswith(SIGNATURE):
            (begin / str(number)).write_bytes(bare(data))
    before = set(FOUND.glob("failure-*"))
    time, prefix = f"-max_total_time={max(1, round(60 * minutes))}", f"-artifact_prefix={FOUND / 'failure-'}"
    options = [*LIMITS, time, f"-seed={seed}", prefix, "-print_final_stats=1", "-verbosity=0"]
    status = subprocess.run([program, *options, found, begin, FORMER], check=False).returncode
    for path in set(FOUND.glob("failure-*")) - before:
        print(f"failed; to repeat: {sys.executable} -m tests.native.fuzz --repeat {path}", file=sys.stderr)
    return status


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=5)
    parser.add_argument("--repeat", type=Path, metavar="FILE", help="run one input")
    arguments = parser.parse_args()
    if not shutil.which("clang++", path=PATH):
        print("Fuzzing needs packages that are missing: sudo apt install clang libclang-rt-dev", file=sys.stderr)
        return 1
    options = ("-DSG_FUZZ=ON", "-DSG_PYTHON=OFF", "-DSG_SANITIZE=fuzzer-no-link,address,undefined")
    program = build("fuzz", *options, environment=CLANG) / "sg_fuzz"
    if arguments.repeat:
        return subprocess.run([program, arguments.repeat], check=False).returncode
    return fuzz(program, arguments.minutes)


if __name__ == "__main__":
    sys.exit(main())
