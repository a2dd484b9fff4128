"""Version 3 of the file, which profile rd wrote before version 4: a short header, then one entropy-coded payload.

It is read for ever, and written no more.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sgmethod.bitstream import payload
from sgmethod.bitstream.payload import FLAG_GREY, FLAG_UPRIGHT, HEADER_BYTES, CodedStream
from sgmethod.bitstream.stream import NO_LIMITS, Limits

HEADER = payload.header_of(FLAG_GREY | FLAG_UPRIGHT)


@dataclass(frozen=True)
class StreamV3(CodedStream):
    """A version 3 file. The fields as in CodedStream, without texture and alpha."""

    VERSION: ClassVar[int] = 3
    CODING: ClassVar[int] = 3
    MIN_BYTES: ClassVar[int] = HEADER_BYTES

    @classmethod
    def parse(cls, body: memoryview, limits: Limits = NO_LIMITS) -> StreamV3:
        """From what follows the checksum. The payload is not looked at. Raises BitstreamError."""
        _, said = payload.read_header(HEADER, body, limits)
        return cls(*said, bytes(body[HEADER.size :]))

    def body(self) -> bytes:
        """What follows the checksum."""
        return payload.write_header(HEADER, self) + self.payload

    def size_bits(self) -> dict[str, int]:
        """Bits spent on the header and on the payload, which mixes all attributes."""
        return {"headers": 8 * HEADER_BYTES, "payload": 8 * len(self.payload)}
