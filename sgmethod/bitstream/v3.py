"""Version 3 of the file, which profile rd wrote before version 4: a short header, then one entropy-coded payload.

It is read for ever, and written no more.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sgmethod.bitstream import payload
from sgmethod.bitstream.payload import FLAG_GREY, FLAG_UPRIGHT, HEADER_BYTES, CodedInfo
from sgmethod.bitstream.stream import NO_LIMITS, LaidOut, Limits
from sgmethod.native import native
from sgmethod.scene import Gaussians, Scene

HEADER = payload.header_of(FLAG_GREY | FLAG_UPRIGHT)


@dataclass(frozen=True)
class StreamV3:
    """A version 3 file. The fields as in Coded (payload.py)."""

    VERSION: ClassVar[int] = 3
    MIN_BYTES: ClassVar[int] = HEADER_BYTES

    width: int
    height: int
    quantum: float
    background: tuple[int, int, int]
    grey: bool
    upright: bool
    payload: bytes
    alpha: ClassVar[None] = None

    @classmethod
    def parse(cls, body: memoryview, limits: Limits = NO_LIMITS) -> StreamV3:
        """From what follows the checksum. The payload is not looked at. Raises BitstreamError."""
        _, said = payload.read_header(HEADER, body, limits)
        return cls(*said, bytes(body[HEADER.size :]))

    def body(self) -> bytes:
        """What follows the checksum."""
        return payload.write_header(HEADER, self) + self.payload

    def gaussians(self, prefix: float = 1.0, limits: Limits = NO_LIMITS) -> Gaussians:
        """The Gaussians, largest first; with prefix < 1 those in that part of the payload.

        Raises BitstreamError, also for more Gaussians than the limit.
        """
        return payload.read_gaussians(self, prefix, limits)

    def lay_out(self, prefix: float = 1.0, texture: bool = True) -> LaidOut:
        """The whole picture as it is drawn. Raises BitstreamError."""
        del texture
        return payload.lay_out(self, prefix, pyramid=False)

    def scene(self, prefix: float = 1.0) -> Scene:
        """What is to be drawn, as far as that part of the payload tells. Raises BitstreamError."""
        return Scene(self.gaussians(prefix), self.width, self.height, self.background, native.CUTOFF_V3)

    def info(self, file_bytes: int, checksum: str, limits: Limits = NO_LIMITS) -> CodedInfo:
        """The description of the file. Raises BitstreamError, also for more Gaussians than the limit."""
        return payload.info_of(self, len(self.gaussians(limits=limits)), self.size_bits(), file_bytes, checksum)

    def size_bits(self) -> dict[str, int]:
        """Bits spent on the header and on the payload, which mixes all attributes."""
        return {"headers": 8 * HEADER_BYTES, "payload": 8 * len(self.payload)}
