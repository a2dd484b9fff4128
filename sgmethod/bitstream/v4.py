"""Version 4 of the file, which profile rd wrote before version 5: a header, perhaps texture and alpha, the payload.

Its shapes are clipped by no fineness of the steps, as those of version 3 were, and are drawn in a pyramid. It is read
for ever, and written no more.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sgmethod.bitstream import payload
from sgmethod.bitstream.fields import Field, Header
from sgmethod.bitstream.payload import (
    FLAG_ALPHA,
    FLAG_GREY,
    FLAG_TEXTURE,
    FLAG_UPRIGHT,
    HEADER_BYTES,
    QUANTUM,
    CodedStream,
    quantum_code,
    quantum_of,
)
from sgmethod.bitstream.stream import NO_LIMITS, Limits
from sgmethod.bitstream.texture import pack, unpack
from sgmethod.errors import BitstreamError

HEADER = payload.header_of(FLAG_GREY | FLAG_UPRIGHT | FLAG_TEXTURE | FLAG_ALPHA)
ALPHA_HEADER = Header((QUANTUM, Field("background", 1, 0, 255), Field("bytes", 4, 0, 2**32 - 1)))  # of the payload


@dataclass(frozen=True)
class StreamV4(CodedStream):
    """A version 4 file. The fields as in CodedStream."""

    VERSION: ClassVar[int] = 4
    MIN_BYTES: ClassVar[int] = HEADER_BYTES

    @classmethod
    def parse(cls, body: memoryview, limits: Limits = NO_LIMITS) -> StreamV4:
        """From what follows the checksum. The payloads are not looked at. Raises BitstreamError."""
        flags, said = payload.read_header(HEADER, body, limits)
        width, height, *_ = said
        rest = bytes(body[HEADER.size :])
        texture = alpha = None
        if flags & FLAG_TEXTURE:
            texture, length = unpack(rest, width, height)
            rest = rest[length:]
        if flags & FLAG_ALPHA:
            alpha, length = _unpack_alpha(rest, width, height)
            rest = rest[length:]
        return cls(*said, rest, texture, alpha)

    def body(self) -> bytes:
        """What follows the checksum."""
        more = FLAG_TEXTURE * (self.texture is not None) | FLAG_ALPHA * (self.alpha is not None)
        header = payload.write_header(HEADER, self, more)
        return header + self._texture_part() + self._alpha_part() + self.payload

    def _texture_part(self) -> bytes:
        return b"" if self.texture is None else pack(self.texture)

    def _alpha_part(self) -> bytes:
        return b"" if self.alpha is None else _pack_alpha(self.alpha)

    def size_bits(self) -> dict[str, int]:
        """Bits spent on the header, on texture, on alpha and on the payload, which mixes all attributes."""
        parts = {"texture": self._texture_part(), "alpha": self._alpha_part(), "payload": self.payload}
        return {"headers": 8 * HEADER_BYTES, **{name: 8 * len(part) for name, part in parts.items()}}


def _pack_alpha(alpha: StreamV4) -> bytes:
    """The alpha part's bytes: what is not the same as in the picture. It has no flags: alpha is grey, and has shear."""
    assert not alpha.payload or (alpha.grey and not alpha.upright)
    said = {"quantum": quantum_code(alpha.quantum), "background": alpha.background[0], "bytes": len(alpha.payload)}
    return ALPHA_HEADER.write(said) + alpha.payload


def _unpack_alpha(data: bytes, width: int, height: int) -> tuple[StreamV4, int]:
    """The alpha that data begin with, of a picture in pixels, and how many bytes it took. Raises BitstreamError."""
    begin = ALPHA_HEADER.size
    if len(data) < begin:
        raise BitstreamError("the file is damaged: its alpha is truncated")
    said = ALPHA_HEADER.read(data)
    end = begin + said["bytes"]
    if len(data) < end:
        raise BitstreamError("the file is damaged: its alpha is truncated")
    quantum, background = quantum_of(said["quantum"]), (said["background"],) * 3
    return StreamV4(width, height, quantum, background, grey=True, upright=False, payload=data[begin:end]), end
