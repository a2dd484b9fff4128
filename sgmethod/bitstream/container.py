"""The .sg file: magic, version and checksum, which all versions share, and which module reads which version.

magic "SGM" | version, 1 byte | CRC-32 of all that follows, 4 bytes | the version's own header and payload
"""

from __future__ import annotations

import importlib
import struct
import zlib

from sgmethod.bitstream.stream import MAGIC, NO_LIMITS, PREFIX_BYTES, Info, Limits, Stream
from sgmethod.errors import BitstreamError

# A new version of the format is a module beside this one, and a line here. Only those that are met are imported: a
# decode from a cold start waits for each.
STREAMS = {1: "v1.StreamV1", 3: "v3.StreamV3", 4: "v4.StreamV4"}
CHECKSUM = struct.Struct(">I")


def serialise(stream: Stream) -> bytes:
    """The file's bytes."""
    body = stream.body()
    return MAGIC + bytes([stream.VERSION]) + CHECKSUM.pack(zlib.crc32(body)) + body


def parse(data: bytes, limits: Limits = NO_LIMITS) -> Stream:
    """The stream in a file of any version.

    Raises BitstreamError for anything but a whole, intact file within the limits.
    """
    if len(data) < PREFIX_BYTES:
        raise BitstreamError(f"the file is too short: {len(data)} bytes")
    if data[:3] != MAGIC:
        raise BitstreamError("this is not an .sg file")
    version = _stream_of(data[3])
    if len(data) < version.MIN_BYTES:
        raise BitstreamError(f"the file is too short: {len(data)} bytes")
    body = memoryview(data)[PREFIX_BYTES:]
    if zlib.crc32(body) != CHECKSUM.unpack(data[4:PREFIX_BYTES])[0]:
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
    return data[4:PREFIX_BYTES].hex()


def info(data: bytes, limits: Limits = NO_LIMITS) -> Info:
    """What a file says of itself. Raises BitstreamError."""
    return parse(data, limits).info(len(data), checksum(data), limits)
