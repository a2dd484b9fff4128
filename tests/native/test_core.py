"""The core without Python: its own program of tests (tests/native/core), built by cmake and run by ctest."""

from __future__ import annotations

import subprocess
from pathlib import Path

from tests.native.harness.build import build, tool


def core() -> Path:
    """The folder of the build."""
    return build("core", "-DSG_PYTHON=OFF", "-DSG_TESTS=ON")


def test_the_core_builds_and_passes_its_tests_without_python() -> None:
    """Slow: it compiles all kernels."""
    command = [tool("ctest"), "--test-dir", str(core()), "--output-on-failure", "--timeout", "120"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
