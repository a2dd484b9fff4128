"""SG_ISA, with which one machine makes the files of another."""

from __future__ import annotations

import hashlib
import sys

import pytest

import sgmethod
from sgmethod.native import ISAS, native
from tests.support.data import golden_path
from tests.support.processes import Outcome, run

GOLDEN = golden_path("v2-color.sg")
PROGRAM = """
import hashlib, numpy, sgmethod
from sgmethod.native import native
ramp = numpy.arange(64 * 48 * 3, dtype=numpy.uint32).reshape(48, 64, 3) % 251
made = sgmethod.encode(ramp.astype(numpy.uint8), bytes=150, effort=1, tune="psnr").data
print(native.best_isa(), hashlib.sha256(sgmethod.decode({path!r})).hexdigest(), made.hex())
"""


def under(isa: str, *command: str) -> Outcome:
    return run(*command, SG_ISA=isa, SG_THREADS="1")


@pytest.mark.parametrize("isa", ISAS[: native.best_isa() + 1])
def test_no_better_instruction_set_is_used(isa: str) -> None:
    first, second = (under(isa, sys.executable, "-c", PROGRAM.format(path=str(GOLDEN))) for _ in range(2))
    assert first.status == 0, first.stderr
    best, pixels, made = first.stdout.split()
    assert int(best) == ISAS.index(isa)
    assert pixels == hashlib.sha256(sgmethod.decode(GOLDEN).tobytes()).hexdigest()  # exact everywhere
    assert made in second.stdout


@pytest.mark.parametrize("isa", ["sse4", "AVX2", "avx512 "])
def test_an_unknown_one_is_refused(isa: str) -> None:
    done = under(isa, sys.executable, "-c", f"import sgmethod; sgmethod.decode({str(GOLDEN)!r})")
    assert done.status == 1
    assert "SG_ISA must be baseline" in done.stderr
    assert f"not {isa!r}" in done.stderr
