"""Fuzz target (atheris, which is libFuzzer): whole files of some versions of the format, through the decoder in Python.

python -m tests.native.fuzz.containers 1|3,4,5 [libFuzzer's arguments]. Magic, version and checksum are put right before
a file is decoded, or hardly any would get past them. Whatever the rest is, there are pixels or one of the package's
errors.
"""

from __future__ import annotations

import sys
import zlib

import atheris

with atheris.instrument_imports(include=["sgmethod"], enable_loader_override=False):
    from sgmethod import BitstreamError, View, ViewError, decode, info, set_threads

from tests.harness.data import NEW, with_checksum

MAX_PIXELS = 1 << 14
MAX_GAUSSIANS = 1 << 14
PREFIX_BYTES = 8  # magic, version, CRC-32 of all that follows
VIEWS = (View(), View(scale=0.3), View(scale=1.7, prefix=0.6), View(region=(1, 2, 5, 4)))


def target(data: bytes, versions: bytes) -> None:
    """Decodes a file with everything but its checksum; of the first version if its own is another."""
    version, body = data[3:4], data[PREFIX_BYTES:]
    if data.startswith(NEW) and 5 in versions and len(data) > 6:
        file = with_checksum(data)
    else:
        begin = b"SGM" + (version if version and version in versions else versions[:1])
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
    versions = bytes(int(version) for version in sys.argv.pop(1).split(","))
    set_threads(1)
    atheris.Setup(sys.argv, lambda data: target(data, versions))
    atheris.Fuzz()


if __name__ == "__main__":
    main()
