"""The core without Python: its own program of tests (tests/native/core), built by cmake and run by ctest."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

from benchmarks.harness.data import ROOT, golden_path
from sgmethod import decode
from sgmethod.bitstream import container
from sgmethod.bitstream.v2 import StreamV2
from tests.native.harness.build import build, tool


def core() -> Path:
    """The folder of the build."""
    return build("core", "-DSG_PYTHON=OFF", "-DSG_TESTS=ON")


def test_the_cores_golden_file_is_ours() -> None:
    source = (ROOT / "tests" / "native" / "core" / "golden.cpp").read_text()
    data = golden_path("v2-texture.sg").read_bytes()
    stream = container.parse(data)
    assert isinstance(stream, StreamV2)
    (parameters,) = re.findall(r"kPicture\((.*)\);", source)
    assert parameters == f"{stream.width}, {stream.height}, {stream.quantum}, false, false"
    assert (stream.grey, stream.upright, stream.is_short) == (False, False, False)
    assert f"kBackground = {stream.background[0]};" in source
    assert stream.texture is not None
    assert stream.texture.ravel().tolist() == list(range(16))
    assert "".join(re.findall(r'^    "(\w+)"', source, re.MULTILINE)) == stream.payload.hex()
    found = 0xCBF29CE484222325
    for byte in decode(data).tobytes():
        found = (found ^ byte) * 0x100000001B3 % 2**64
    assert f"kPixels = {found:#018x};" in source


def test_the_core_builds_and_passes_its_tests_without_python() -> None:
    """Slow: it compiles all kernels."""
    command = [tool("ctest"), "--test-dir", str(core()), "--output-on-failure", "--timeout", "120"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
