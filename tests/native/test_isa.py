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
CODED = """
import hashlib, numpy
from sgmethod.native import native
from tests.backend.cases import scattered
parameters, whole = native.RdParameters(700, 500, 0.05), scattered(3000, 0, (700, 500))
coded = native.rd_encode(parameters, *whole.arrays)
decoded = native.rd_decode(parameters, coded, False)
print(hashlib.sha256(coded + b"".join(array.tobytes() for array in decoded)).hexdigest())
"""
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


def test_gaussians_are_coded_the_same() -> None:
    """And decoded: the map is made of binary32 numbers."""
    found = {isa: under(isa, sys.executable, "-c", CODED) for isa in ISAS[: native.best_isa() + 1]}
    assert {isa: done.stderr for isa, done in found.items() if done.status != 0} == {}
    assert len({done.stdout for done in found.values()}) == 1


@pytest.mark.parametrize("isa", ["sse4", "AVX2", "avx512 "])
def test_an_unknown_one_is_refused(isa: str) -> None:
    done = under(isa, sys.executable, "-c", f"import sgmethod; sgmethod.decode({str(GOLDEN)!r})")
    assert done.status == 1
    assert "SG_ISA must be baseline" in done.stderr
    assert f"not {isa!r}" in done.stderr
