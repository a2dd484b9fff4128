"""Runs the native code under sanitizers: python -m tests.native.sanitize [--mutations N] [--seed S].

Under those of addresses and of undefined behaviour: the core's tests, then the real decoder in Python on the golden
files and on damaged copies of them. Under that of threads: the core's tests again.
"""

from __future__ import annotations

import argparse
import os
import random
import shlex
import subprocess
import sys
from pathlib import Path

from tests.native.harness.build import build, imports, layout, nanobind
from tests.support.data import ROOT

GCC = {"CC": "gcc", "CXX": "g++"}
ASAN = "detect_leaks=1:detect_stack_use_after_return=1:strict_string_checks=1"
UBSAN = {"UBSAN_OPTIONS": "print_stacktrace=1"}
TSAN = {"TSAN_OPTIONS": "die_after_fork=0:halt_on_error=1"}  # the pool's tests fork, and start threads in the child


def runtime(name: str) -> str:
    """Where the compiler keeps a library of its own."""
    command = [GCC["CXX"], f"-print-file-name={name}"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def run(what: str, command: list[str], environment: dict[str, str], folder: Path = ROOT) -> None:
    """Ends the program where a command fails, and says how to repeat it."""
    print(f"--- {what}", flush=True)
    done = subprocess.run(command, cwd=folder, env={**os.environ, **environment}, check=False)
    if done.returncode != 0:
        settings = [f"{name}={value}" for name, value in environment.items()]
        print(f"failed: cd {folder} && {shlex.join(['env', *settings, *command])}", file=sys.stderr)
        sys.exit(1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mutations", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(2**32))
    arguments = parser.parse_args()

    checks = "-DSG_SANITIZE=address,undefined,float-cast-overflow"
    built = build("asan", "-DSG_TESTS=ON", checks, nanobind(), environment=GCC)
    run(
        "the core's tests: addresses, undefined behaviour, leaks",
        [str(built / "sg_tests")],
        {"ASAN_OPTIONS": ASAN, **UBSAN},
    )
    folder = layout(built)
    environment = {
        "PYTHONPATH": imports(folder),
        "LD_PRELOAD": " ".join(map(runtime, ("libasan.so", "libubsan.so", "libstdc++.so"))),
        "ASAN_OPTIONS": f"{ASAN}:leak_check_at_exit=0",  # mutations.py looks for leaks itself
        **UBSAN,
    }
    decoder = [sys.executable, "-S", "-m", "tests.native.sanitize.mutations"]
    numbers = [str(arguments.mutations), str(arguments.seed)]
    run("the decoder in Python: the same", [*decoder, *numbers], environment, folder)

    built = build("tsan", "-DSG_PYTHON=OFF", "-DSG_TESTS=ON", "-DSG_SANITIZE=thread", environment=GCC)
    run("the core's tests: threads", [str(built / "sg_tests")], TSAN)


if __name__ == "__main__":
    main()
