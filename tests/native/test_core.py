"""The core without Python: its own program of tests (tests/native/core), built by cmake and run by ctest; its links."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import sgmethod.native
from tests.native.harness.build import build, tool


def core() -> Path:
    """The folder of the build."""
    return build("core", "-DSG_PYTHON=OFF", "-DSG_TESTS=ON")


def symbols(room: Path, kind: str) -> set[str]:
    """Those that the compiled sources of a room define for others, or leave undefined."""
    command = [tool("nm"), "--format=posix", "--extern-only", kind, *sorted(room.glob("*.o"))]
    listing = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return set(re.findall(r"^(\w+) ", listing, re.MULTILINE))


def test_the_core_builds_and_passes_its_tests_without_python() -> None:
    command = [tool("ctest"), "--test-dir", str(core()), "--output-on-failure", "--timeout", "120"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


def test_rooms_link_one_way() -> None:
    """A room calls nothing that a later one defines, in the order of the native package's text."""
    compiled = core() / "CMakeFiles" / "sg_core.dir"
    order = [name for name in re.findall(r"(\w+)/", sgmethod.native.__doc__ or "") if (compiled / name).is_dir()]
    later: set[str] = set()
    called = 0
    for name in reversed(order):
        undefined = symbols(compiled / name, "--undefined-only")
        assert not undefined & later, name
        later |= symbols(compiled / name, "--defined-only")
        called += len(undefined)
    assert len(order) > 5
    assert called > 50
