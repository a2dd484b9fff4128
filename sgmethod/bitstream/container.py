"""The .sg file: signature, version and checksum, around what the reader of its version makes of the rest.

signature, 2 bytes, with the version | header and payload | checksum, 1 or 4 bytes
"""

from __future__ import annotations

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
from sgmethod.profiles import READERS, imported


def serialise(stream: Stream) -> bytes:
    """Write a file."""
    return with_checksum(bytes([SIGNATURE, VERSION_ZERO + stream.VERSION]) + stream.body())


def with_checksum(begun: bytes) -> bytes:
    """Append the checksum to the bytes before it."""
    return begun + zlib.crc32(begun).to_bytes(LONG_CHECKSUM, "big")[-_checksum_bytes(begun) :]


def _checksum_bytes(data: bytes) -> int:
    """Size of the checksum: short if the first bit after the signature is set."""
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
    version = reader_of(version_of(data))
    if len(data) < version.MIN_BYTES:
        raise BitstreamError(f"the file is too short: {len(data)} bytes")
    end = len(data) - _checksum_bytes(data)
    if with_checksum(data[:end]) != data:
        raise BitstreamError("the file is damaged: its checksum does not match")
    return version.parse(memoryview(data)[SIGNATURE_BYTES:end], limits)


def reader_of(version: int) -> type[Stream]:
    """Import what reads a version, now that a file needs it: it delays a decode from a cold start."""
    if version not in READERS:
        raise BitstreamError(f"format version {version} is not supported: update sgmethod")
    found: type[Stream] = imported(READERS[version])
    return found


def checksum(data: bytes) -> str:
    """Return a file's checksum as hexadecimal digits."""
    return data[-_checksum_bytes(data) :].hex()


def info(data: bytes, limits: Limits = NO_LIMITS) -> Info:
    """Describe a file. Raises BitstreamError."""
    return parse(data, limits).info(len(data), checksum(data), limits)
