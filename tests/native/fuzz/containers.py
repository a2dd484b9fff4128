"""Fuzz target (atheris, which is libFuzzer): whole files of one version of the format, through the decoder in Python.

python -m tests.native.fuzz.containers v1|v3 [libFuzzer's arguments]. Magic, version and checksum are put right before
a file is decoded, or hardly any would get past them. Whatever the rest is, there are pixels or one of the package's
errors.
"""

from __future__ import annotations

import sys
import zlib

import atheris

with atheris.instrument_imports(include=["sgmethod"], enable_loader_override=False):
    from sgmethod import BitstreamError, View, ViewError, decode, info, set_threads

MAX_PIXELS = 1 << 14
MAX_GAUSSIANS = 1 << 14
VERSIONS = {"v1": b"SGM\x01", "v3": b"SGM\x03"}
PREFIX_BYTES = 8  # magic, version, CRC-32 of all that follows
VIEWS = (View(), View(scale=0.3), View(scale=1.7, prefix=0.6), View(region=(1, 2, 5, 4)))


def target(data: bytes, begin: bytes) -> None:
    """Decodes a file with everything that follows its first eight bytes."""
    body = data[PREFIX_BYTES:]
    file = begin + zlib.crc32(body).to_bytes(4, "big") + body
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
    version = sys.argv.pop(1)
    set_threads(1)
    atheris.Setup(sys.argv, lambda data: target(data, VERSIONS[version]))
    atheris.Fuzz()


if __name__ == "__main__":
    main()
