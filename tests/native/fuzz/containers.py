"""Fuzz target (atheris, which is libFuzzer): whole files of one version of the format, through the decoder in Python.

python -m tests.native.fuzz.containers 1|2 [libFuzzer's arguments]. Signature and checksum are put right before a file
is decoded, or hardly any would get past them. Whatever the rest is, there are pixels or one of the package's errors.
"""

from __future__ import annotations

import sys

import atheris

with atheris.instrument_imports(include=["sgmethod"], enable_loader_override=False):
    from sgmethod import BitstreamError, View, ViewError, decode, info, set_threads

from benchmarks.harness.data import SIGNATURES, with_checksum

MAX_PIXELS = 1 << 14
MAX_GAUSSIANS = 1 << 14
VIEWS = (View(), View(scale=0.3), View(scale=1.7, prefix=0.6), View(region=(1, 2, 5, 4)))


def target(data: bytes, version: int) -> None:
    """Decode a file with everything but its signature and checksum."""
    if len(data) < 7:
        return
    file = with_checksum(SIGNATURES[version - 1] + data[2:])
    try:
        info(file, MAX_GAUSSIANS)
        for view in VIEWS:
            try:
                pixels = decode(file, MAX_PIXELS, view)
            except ViewError:
                continue
            assert pixels.size <= 3 * MAX_PIXELS
    except BitstreamError:
        pass


def main() -> None:
    version = int(sys.argv.pop(1))
    set_threads(1)
    atheris.Setup(sys.argv, lambda data: target(data, version))
    atheris.Fuzz()


if __name__ == "__main__":
    main()
