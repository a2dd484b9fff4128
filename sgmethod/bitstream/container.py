"""The .sg file: magic, version and checksum, and which module reads which version.

Versions 1 to 4: magic "SGM" | version, 1 byte | CRC-32 of all that follows, 4 bytes | the version's header and payload
From version 5: signature, 2 bytes, with the version | header and payload | checksum, 1 or 4 bytes
"""

from __future__ import annotations

import importlib
import struct
import zlib

from sgmethod.bitstream.stream import (
    LONG_CHECKSUM,
    MAGIC,
    NO_LIMITS,
    PREFIX_BYTES,
    SHORT_CHECKSUM,
    SIGNATURE,
    SIGNATURE_BYTES,
    Info,
    Limits,
    Stream,
)
from sgmethod.errors import BitstreamError

# A new version of the format is a module beside this one, and a line here. Only those that are met are imported: a
# decode from a cold start waits for each.
STREAMS = {1: "v1.StreamV1", 3: "v3.StreamV3", 4: "v4.StreamV4", 5: "v5.StreamV5"}
LAST_WITH_MAGIC = 4
CHECKSUM = struct.Struct(">I")


def serialise(stream: Stream) -> bytes:
    """The file's bytes."""
    body = stream.body()
    if stream.VERSION <= LAST_WITH_MAGIC:
        return MAGIC + bytes([stream.VERSION]) + CHECKSUM.pack(zlib.crc32(body)) + body
    return with_checksum(bytes([SIGNATURE[0], SIGNATURE[1] + stream.VERSION]) + body)


def with_checksum(begun: bytes) -> bytes:
    """A file of version 5 from all that comes before its checksum."""
    return begun + CHECKSUM.pack(zlib.crc32(begun))[-_checksum_bytes(begun) :]


def _checksum_bytes(data: bytes) -> int:
    """Of a file of version 5: the first bit after the signature says whether it is short."""
    return SHORT_CHECKSUM if data[SIGNATURE_BYTES] & 0x80 else LONG_CHECKSUM


def version_of(data: bytes) -> int:
    """The version that the first bytes of a file say. Raises BitstreamError where they are not those of a file."""
    if data[:3] == MAGIC and len(data) > 3 and data[3] <= LAST_WITH_MAGIC:
        return data[3]
    if len(data) >= SIGNATURE_BYTES and data[0] == SIGNATURE[0] and LAST_WITH_MAGIC < data[1] - SIGNATURE[1] < 16:
        return data[1] - SIGNATURE[1]
    if data[:3] == MAGIC and len(data) > 3:
        raise BitstreamError(f"version {data[3]} of the format is not known to this decoder")
    raise BitstreamError("this is not an .sg file")


def parse(data: bytes, limits: Limits = NO_LIMITS) -> Stream:
    """The stream in a file of any version.

    Raises BitstreamError for anything but a whole, intact file within the limits.
    """
    if len(data) < SIGNATURE_BYTES:
        raise BitstreamError(f"the file is too short: {len(data)} bytes")
    version = _stream_of(version_of(data))
    if len(data) < version.MIN_BYTES:
        raise BitstreamError(f"the file is too short: {len(data)} bytes")
    if version.VERSION <= LAST_WITH_MAGIC:
        body = memoryview(data)[PREFIX_BYTES:]
        intact = zlib.crc32(body) == CHECKSUM.unpack(data[4:PREFIX_BYTES])[0]
    else:
        end = len(data) - _checksum_bytes(data)
        body = memoryview(data)[SIGNATURE_BYTES:end]
        intact = with_checksum(data[:end]) == data
    if not intact:
        raise BitstreamError("the file is damaged: its checksum does not match")
    return version.parse(body, limits)


def _stream_of(version: int) -> type[Stream]:
    if version not in STREAMS:
        raise BitstreamError(f"format version {version} is not supported: update sgmethod")
    module, name = STREAMS[version].split(".")
    found: type[Stream] = getattr(importlib.import_module(f"sgmethod.bitstream.{module}"), name)
    return found


def checksum(data: bytes) -> str:
    """Of a file, as hexadecimal digits."""
    if version_of(data) <= LAST_WITH_MAGIC:
        return data[4:PREFIX_BYTES].hex()
    return data[-_checksum_bytes(data) :].hex()


def info(data: bytes, limits: Limits = NO_LIMITS) -> Info:
    """What a file says of itself. Raises BitstreamError."""
    return parse(data, limits).info(len(data), checksum(data), limits)
