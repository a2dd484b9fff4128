"""Fuzzes the decoder with new random seeds: python -m tests.native.fuzz [--minutes N] [--target NAME].

entropy: the entropy decoder and the drawing, in C++ alone; v1, rd: whole files of version 1, and of version 2,
through the decoder in Python. All are built by Clang with the sanitizers of addresses and of undefined behaviour. New
finds go to build/fuzz/.
An input that fails is kept, and the command that repeats it printed: python -m tests.native.fuzz --repeat NAME FILE.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from typing import TextIO

from benchmarks.harness.data import ROOT, golden
from sgmethod.bitstream import container
from sgmethod.bitstream.v2 import StreamV2, quantum_code
from tests.native.harness.build import BUILDS, PATH, build, imports, layout, nanobind

TARGETS = {"entropy": 2, "v1": 1, "rd": 2}  # and their versions of the format
CORPUS = Path(__file__).parent / "corpus"  # what was found once
FOUND = BUILDS / "fuzz" / "found"
CLANG = {"CC": "clang", "CXX": "clang++"}
# Limits of time and memory for one input; sanitizers multiply both.
LIMITS = ("-timeout=20", "-rss_limit_mb=4096", "-max_len=4096")


def missing() -> str:
    """The Debian packages that are missing, or nothing."""
    if not shutil.which("clang++", path=PATH):
        return "clang libclang-rt-dev"

    def output(option: str) -> str:
        return subprocess.run(["clang++", option], capture_output=True, text=True, check=True).stdout.strip()

    if list(Path(output("-print-resource-dir")).rglob("libclang_rt.fuzzer*.a")):
        return ""
    return f"libclang-rt-{output('-dumpversion').split('.')[0]}-dev"


def command_of(target: str, built: Path) -> tuple[list[str], dict[str, str]]:
    """The fuzz target's command, and what its environment needs beside this one's."""
    if target == "entropy":
        return [str(built / "sg_fuzz")], {}
    import atheris

    runtime = Path(atheris.path()) / "asan_with_fuzzer.so"
    return (
        [sys.executable, "-S", "-m", "tests.native.fuzz.containers", str(TARGETS[target])],
        # What Python keeps to its end looks like leaks.
        {"PYTHONPATH": imports(layout(built)), "LD_PRELOAD": str(runtime), "ASAN_OPTIONS": "detect_leaks=0"},
    )


def run(target: str, built: Path, *arguments: str | Path, output: TextIO | None = None) -> int:
    """The exit status of a fuzz target."""
    command, more = command_of(target, built)
    folder = ROOT if target == "entropy" else layout(built)
    environment = {**os.environ, **more}
    done = subprocess.run(
        [*command, *arguments], cwd=folder, env=environment, stdout=output, stderr=output, check=False
    )
    return done.returncode


def corpora(target: str) -> list[Path]:
    """Folders of inputs: new finds first, then what to begin with, the golden files and what was found once."""
    found, begin = FOUND / target, FOUND / f"golden-{target}"
    for folder in (found, begin):
        folder.mkdir(parents=True, exist_ok=True)
    for name, data in golden(TARGETS[target]).items():
        (begin / name).write_bytes(bare(data) if target == "entropy" else data)
    return [found, begin, *CORPUS.glob(target)]


def bare(data: bytes) -> bytes:
    """A file of profile rd as entropy.cpp takes it."""
    stream = container.parse(data)
    assert isinstance(stream, StreamV2)
    code = quantum_code(stream.quantum)
    flags = stream.grey | stream.upright << 1 | (stream.texture is not None) << 4 | stream.is_short << 5
    size = stream.width, stream.height
    return struct.pack(">HHBBB", *size, 13 - (code >> 8), code & 255, flags) + stream.payload


def fuzz(target: str, built: Path, minutes: float) -> bool:
    """Whether a target got through its time without a failure."""
    seed = random.SystemRandom().randrange(1, 2**31)
    print(f"--- {target}: {minutes:g} minutes with seed {seed}", flush=True)
    folders = corpora(target)
    log, failures = FOUND / f"log-{target}", f"failure-{target}-"
    before = set(FOUND.glob(f"{failures}*"))
    options = [
        f"-max_total_time={max(1, round(60 * minutes))}",
        f"-seed={seed}",
        f"-artifact_prefix={FOUND / failures}",
    ]
    with log.open("w") as output:
        status = run(target, built, *LIMITS, *options, "-print_final_stats=1", *folders, output=output)
    lines = log.read_text(errors="replace").splitlines()
    print("\n".join(line for line in lines if line.startswith("stat::")))
    if status != 0:
        print("\n".join(lines[-60:]), file=sys.stderr)
    for path in set(FOUND.glob(f"{failures}*")) - before:
        print(f"failed; to repeat: {sys.executable} -m tests.native.fuzz --repeat {target} {path}", file=sys.stderr)
    return status == 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=5, help="for each target")
    parser.add_argument("--target", choices=TARGETS, action="append", help="only this one")
    parser.add_argument("--repeat", nargs=2, metavar=("NAME", "FILE"), help="run one input of a target")
    arguments = parser.parse_args()
    if packages := missing():
        print(f"Fuzzing needs packages that are missing: sudo apt install {packages}", file=sys.stderr)
        return 1
    options = ("-DSG_FUZZ=ON", "-DSG_SANITIZE=fuzzer-no-link,address,undefined", nanobind())
    built = build("fuzz", *options, environment=CLANG)
    if arguments.repeat:
        target, file = arguments.repeat
        return run(target, built, Path(file).resolve())
    results = [fuzz(target, built, arguments.minutes) for target in arguments.target or TARGETS]
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
