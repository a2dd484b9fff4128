"""The core without Python: its own program of tests (tests/native/core), built by cmake and run by ctest."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from tests.harness.data import ROOT

BUILD = ROOT / "build" / "core"  # kept, so that only what has changed is compiled


def run(*command: str) -> None:
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


def test_the_core_builds_and_passes_its_tests_without_python() -> None:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    cmake, ctest = (shutil.which(name, path=path) or name for name in ("cmake", "ctest"))
    run(
        cmake,
        "-S",
        "sgmethod/native",
        "-B",
        str(BUILD),
        "-DSG_PYTHON=OFF",
        "-DSG_TESTS=ON",
        "-DCMAKE_CXX_FLAGS=-Werror",
    )
    run(cmake, "--build", str(BUILD), "--parallel")
    run(ctest, "--test-dir", str(BUILD), "--output-on-failure", "--timeout", "120")
