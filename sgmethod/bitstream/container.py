"""The .sg file: signature, version and checksum, and which module reads which version.

signature, 2 bytes, with the version | header and payload | checksum, 1 or 4 bytes
"""

from __future__ import annotations

import importlib
import zlib

from sgmethod.bitstream.stream import (
    LONG_CHECKSUM,
    NO_LIMITS,
    SHORT_CHECKSUM,
    SIGNATURE,
    SIGNATURE_BYTES,
    VERSION_ZERO,
    Info,
    Limits,
    Stream,
)
from sgmethod.errors import BitstreamError
from sgmethod.settings.paper import PaperSettings
from sgmethod.settings.rd import RdSettings

# A new version of the format is a module beside this one, and a line here. A module is imported when a file needs it,
# because each delays a decode from a cold start.
STREAMS = {1: "v1.StreamV1", 2: "v2.StreamV2"}


def serialise(stream: Stream) -> bytes:
    """Write a file."""
    return with_checksum(bytes([SIGNATURE, VERSION_ZERO + stream.VERSION]) + stream.body())


def with_checksum(begun: bytes) -> bytes:
    """Append the checksum to the bytes before it."""
    return begun + zlib.crc32(begun).to_bytes(LONG_CHECKSUM, "big")[-_checksum_bytes(begun) :]


def _checksum_bytes(data: bytes) -> int:
    """Size of the checksum: short if the first bit after the signature is set, which it never is in version 1."""
    return SHORT_CHECKSUM if data[SIGNATURE_BYTES] & 0x80 else LONG_CHECKSUM


def version_of(data: bytes) -> int:
    """Read the version from a file's signature. Raises BitstreamError for anything but an .sg file."""
    if len(data) < SIGNATURE_BYTES or data[0] != SIGNATURE or not 0 < data[1] - VERSION_ZERO < 16:
        raise BitstreamError("this is not an .sg file")
    return data[1] - VERSION_ZERO


def parse(data: bytes, limits: Limits = NO_LIMITS) -> Stream:
    """Parse a file of any version. Raises BitstreamError unless it is whole, intact and within the limits."""
    if len(data) < SIGNATURE_BYTES:
        raise BitstreamError(f"the file is too short: {len(data)} bytes")
    version = _stream_of(version_of(data))
    if len(data) < version.MIN_BYTES:
        raise BitstreamError(f"the file is too short: {len(data)} bytes")
    end = len(data) - _checksum_bytes(data)
    if with_checksum(data[:end]) != data:
        raise BitstreamError("the file is damaged: its checksum does not match")
    return version.parse(memoryview(data)[SIGNATURE_BYTES:end], limits)


def _stream_of(version: int) -> type[Stream]:
    if version not in STREAMS:
        raise BitstreamError(f"format version {version} is not supported: update sgmethod")
    module, name = STREAMS[version].split(".")
    found: type[Stream] = getattr(importlib.import_module(f"sgmethod.bitstream.{module}"), name)
    return found


def checksum(data: bytes) -> str:
    """Return a file's checksum as hexadecimal digits."""
    return data[-_checksum_bytes(data) :].hex()


def info(data: bytes, limits: Limits = NO_LIMITS) -> Info:
    """Describe a file. Raises BitstreamError."""
    return parse(data, limits).info(len(data), checksum(data), limits)


def smallest_file(settings: RdSettings | PaperSettings, *, has_alpha: bool = False) -> int:
    """Bytes of the smallest file that a profile writes for the largest picture."""
    if isinstance(settings, RdSettings):
        from sgmethod.bitstream.v2 import SMALLEST_ALPHA, SMALLEST_FILE

        return SMALLEST_FILE + (SMALLEST_ALPHA if has_alpha else 0)
    from sgmethod.bitstream.v1 import file_bytes, record_bits

    return file_bytes(record_bits(settings.position_bits, settings.min_bitwidth), 1)
