"""The kernels where the system fails them: no memory, no threads, a fork in the middle of a kernel."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.processes import run

SHIMS = Path(__file__).parent / "shims"
Preload = Callable[[str], Path]


@pytest.fixture(scope="module")
def preload(tmp_path_factory: pytest.TempPathFactory) -> Preload:
    """Compiles a shim and returns the library."""
    folder = tmp_path_factory.mktemp("shims")

    def compiled(name: str) -> Path:
        library = folder / f"{name}.so"
        source = SHIMS / f"{name}.c"
        # -fexceptions: an exception passes through. -fno-builtin: malloc is not what the compiler takes it for.
        options = ["-shared", "-fPIC", "-O1", "-fexceptions", "-fno-builtin", "-Wall", "-Wextra", "-Werror"]
        subprocess.run([os.environ.get("CC", "cc"), *options, str(source), "-o", str(library)], check=True)
        return library

    return compiled


def python(*arguments: str, **environment: object) -> str:
    """What a Python process prints, which must end well."""
    done = run(sys.executable, *arguments, **environment)
    assert done.status == 0, f"status {done.status}: {done.stderr[-2000:]}"
    return done.stdout


@pytest.mark.thorough
@pytest.mark.parametrize("whose", ["kernels", "workers"])
def test_any_allocation_may_fail(preload: Preload, whose: str) -> None:
    """Then there is MemoryError or the right result, and the next call is right (tests/native/failing.py).

    Slow: every allocation of every kernel fails once.
    """
    lines = python("-m", "tests.native.failing", whose, LD_PRELOAD=preload("allocations")).splitlines()
    assert len(lines) == {"kernels": 6, "workers": 5}[whose]
    if whose == "kernels":
        for scenario, errors, right in map(str.split, lines):
            assert int(errors) > 0, scenario
            assert int(right) > 0, scenario


FEWER_THREADS = """
import ctypes, io
import numpy as np
from PIL import Image
from sgmethod import decode
from sgmethod.io.kinds.png import encode_png
from sgmethod.native import native
from sgmethod.threads import in_parallel
from tests.native.harness.golden import GOLDEN, is_golden
grant = ctypes.CDLL(None).grant_threads
for granted in (0, 1, 3, 100):
    native.set_thread_count(1)
    assert is_golden("v2-color", decode(GOLDEN["v2-color"]))
    native.set_thread_count(5)
    grant(granted)
    for name in GOLDEN:
        assert is_golden(name, decode(GOLDEN[name])), (granted, name)
    assert in_parallel(lambda n: n * n, range(9)) == [n * n for n in range(9)]
    pixels = decode(GOLDEN["v2-color"])
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(encode_png(pixels)))), pixels)
    assert native.thread_count() == 5
    grant(1000)
print("right")
"""


def test_threads_that_cannot_be_created_are_done_without(preload: Preload) -> None:
    assert python("-c", FEWER_THREADS, LD_PRELOAD=preload("threads")) == "right\n"


def test_cores_and_threads_from_outside() -> None:
    """SG_THREADS as far as it is a number, at most the cores there are: a decode took 46 ms with 64 on two, not 0.9."""
    script = "from sgmethod import machine; from sgmethod.native import native; print(native.thread_count() == {})"
    cores = "min(256, machine.cores())"
    for text, count in (("1", "1"), ("2", "min(2, machine.cores())"), *((text, cores) for text in ("1000", "0", "x"))):
        assert python("-c", script.format(count), SG_THREADS=text) == "True\n"


CALLERS_MODES = """
import ctypes
import numpy as np
from sgmethod import decode
from sgmethod.native import native
from tests.support.data import golden_path

libm = ctypes.CDLL("libm.so.6")
data = golden_path("v2-color.sg").read_bytes()

means, factors = np.full((9, 2), 20.3, np.float32), np.tile(np.float32([0.2, 0.0, 0.1]), (9, 1))
colors, image = np.float32(range(27)).reshape(9, 3) / 30, np.zeros((3, 40, 56), np.float32)

def kernels():
    native.Rasterization(means, factors, 56, 40).render(colors, image)
    return image.tobytes()

for threads in (1, 3):
    native.set_thread_count(threads)
    libm.fesetround(0)
    drawn, decoded = kernels(), decode(data).tobytes()
    for rounding in (0x400, 0x800, 0xC00):
        libm.fesetround(rounding)
        assert (kernels(), decode(data).tobytes()) == (drawn, decoded)
        assert libm.fegetround() == rounding
    libm.fesetround(0)
    libm.feenableexcept(0x3D)  # all, also of inexact results
    trapping = kernels()
    assert libm.fegetexcept() == 0x3D
    libm.fedisableexcept(0x3D)
    assert trapping == drawn
print("right")
"""


@pytest.mark.skipif(platform.machine() != "x86_64" or sys.platform != "linux", reason="numbers of glibc on x86-64")
def test_the_callers_floating_point_mode_is_left_alone_and_does_not_count() -> None:
    """Trapped exceptions ended the process by SIGFPE; another rounding changed pixels."""
    assert python("-c", CALLERS_MODES) == "right\n"
