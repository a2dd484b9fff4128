"""Version 5 of the file (profile rd): a header of a few bytes, perhaps texture and alpha, the payload of version 4.

A file of up to SHORT_BYTES may be short: some fields of its header have fewer bits, its checksum is one byte, and its
payloads have one state in place of two.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import ClassVar

from sgmethod.bitstream.fields import BitField, BitReader, write_bits
from sgmethod.bitstream.payload import (
    FLAG_ALPHA,
    FLAG_GREY,
    FLAG_TEXTURE,
    FLAG_UPRIGHT,
    MIN_QUANTUM,
    CodedStream,
    TexturedInfo,
)
from sgmethod.bitstream.stream import LONG_CHECKSUM, NO_LIMITS, SHORT_CHECKSUM, SIGNATURE_BYTES, Limits
from sgmethod.bitstream.texture import pack, unpack
from sgmethod.errors import BitstreamError

FLAG_SHORT = 16  # the first bit after the signature
FLAGS = BitField("flags", 5, 5)
SIZE = BitField("width", 4, 4, grows=True), BitField("height", 4, 4, grows=True)
QUANTUM = BitField("quantum", 12, 8)  # its code
BACKGROUND = BitField("red", 8, 5), BitField("green", 8, 5), BitField("blue", 8, 5)
ALPHA_BYTES = BitField("alpha_bytes", 5, 5, grows=True)  # of its payload, and 1
HEADER = (FLAGS, *SIZE, QUANTUM, *BACKGROUND)
ALPHA_HEADER = (BitField("alpha_quantum", 12, 8), BitField("alpha_background", 8, 5), ALPHA_BYTES)
SHORT_BYTES = 1024  # up to which our encoder writes short files: beyond, they would gain less than half a percent
SMALLEST_FILE, SMALLEST_ALPHA = 12, 3  # bytes without any Gaussian, of the largest picture; and of opaque alpha


def quantum_of(code: int) -> float:
    """Of a code, (1 + f / 256) 2^(3 - e), e in the upper four bits, f in the lower eight; exact in float64."""
    return (1 + (code & 0xFF) / 256) * 2.0 ** (3 - (code >> 8))


@cache
def _short_codes() -> dict[float, int]:
    codes = (QUANTUM.value(upper) for upper in range(2**QUANTUM.short_bits))
    return {quantum_of(code): code for code in codes if quantum_of(code) >= MIN_QUANTUM}


def quantum_code(quantum: float, is_short: bool = False) -> int:
    """The code of the nearest quantum."""
    if is_short:
        codes = _short_codes()
        return codes[min(codes, key=lambda q: abs(q - quantum))]
    quantum = min(max(quantum, MIN_QUANTUM), quantum_of(255))
    exponent = math.floor(math.log2(quantum))
    fraction = round((quantum / 2.0**exponent - 1) * 256)
    return (3 - exponent - fraction // 256) << 8 | fraction % 256


def coded_background(background: tuple[int, int, int], is_short: bool) -> tuple[int, int, int]:
    """The nearest colour that a file can hold."""
    if not is_short:
        return background
    levels = [BACKGROUND[0].value(upper) for upper in range(2 ** BACKGROUND[0].short_bits)]
    red, green, blue = (min(levels, key=lambda level: abs(level - own)) for own in background)
    return red, green, blue


@dataclass(frozen=True, kw_only=True)
class InfoV5(TexturedInfo):
    """Info of a version 5 file. short: whether it is a short one."""

    short: bool


@dataclass(frozen=True)
class StreamV5(CodedStream):
    """A version 5 file. The fields as in CodedStream."""

    VERSION: ClassVar[int] = 5
    MIN_BYTES: ClassVar[int] = SIGNATURE_BYTES + 4 + SHORT_CHECKSUM  # a short one of a grey pixel
    HAS_BANDED_TEXTURE: ClassVar[bool] = True

    @staticmethod
    def coded_quantum(quantum: float, is_short: bool = False) -> float:
        """The nearest quantum that a file can hold."""
        return quantum_of(quantum_code(quantum, is_short))

    @classmethod
    def parse(cls, body: memoryview, limits: Limits = NO_LIMITS) -> StreamV5:
        """From what lies between signature and checksum. The payloads are not looked at. Raises BitstreamError."""
        bits = BitReader(body)
        (flags,) = bits.read([FLAGS], False)
        is_short, grey = bool(flags & FLAG_SHORT), bool(flags & FLAG_GREY)
        width, height = bits.read(SIZE, is_short)
        (quantum,) = bits.read([QUANTUM], is_short)
        levels = tuple(bits.read(BACKGROUND[:1] if grey else BACKGROUND, is_short))
        red, green, blue = levels * 3 if grey else levels
        of_alpha = tuple(bits.read(ALPHA_HEADER, is_short)) if flags & FLAG_ALPHA else None
        rest = bytes(body[bits.end() :])
        limits.check_size(width, height)
        texture = alpha = None
        if flags & FLAG_TEXTURE:
            texture, length = unpack(rest, width, height)
            rest = rest[length:]
        if of_alpha is not None:
            code, level, length = of_alpha[0], of_alpha[1], of_alpha[2] - 1
            if len(rest) < length:
                raise BitstreamError("the file is damaged: its alpha is cut short")
            alpha = cls(width, height, quantum_of(code), (level,) * 3, True, False, rest[:length], is_short=is_short)
            rest = rest[length:]
        colours = width, height, quantum_of(quantum), (red, green, blue), grey, bool(flags & FLAG_UPRIGHT), rest
        return cls(*colours, texture, alpha, is_short)

    def _header(self) -> Iterator[tuple[BitField, int]]:
        """Each field and its value."""
        more = FLAG_TEXTURE * (self.texture is not None) | FLAG_ALPHA * (self.alpha is not None)
        yield FLAGS, FLAG_GREY * self.grey | FLAG_UPRIGHT * self.upright | FLAG_SHORT * self.is_short | more
        yield from zip(SIZE, (self.width, self.height), strict=True)
        yield QUANTUM, quantum_code(self.quantum, self.is_short)
        yield from zip(BACKGROUND[:1] if self.grey else BACKGROUND, self.background, strict=False)
        if self.alpha is not None:
            code = quantum_code(self.alpha.quantum, self.is_short)
            values = code, self.alpha.background[0], len(self.alpha.payload) + 1
            yield from zip(ALPHA_HEADER, values, strict=True)

    def _parts(self) -> dict[str, bytes]:
        """What follows the header. Alpha has no flags of its own: it is grey, has shear, and is as short."""
        texture = b"" if self.texture is None else pack(self.texture)
        return {"texture": texture, "alpha": b"" if self.alpha is None else self.alpha.payload, "payload": self.payload}

    def body(self) -> bytes:
        """What lies between signature and checksum."""
        if self.alpha is not None and self.alpha.payload:
            assert (self.alpha.grey, self.alpha.upright, self.alpha.is_short) == (True, False, self.is_short)
        return write_bits(self._header(), self.is_short) + b"".join(self._parts().values())

    @property
    def file_bytes(self) -> int:
        """Of the whole file."""
        return SIGNATURE_BYTES + len(self.body()) + (SHORT_CHECKSUM if self.is_short else LONG_CHECKSUM)

    def info(self, file_bytes: int, checksum: str, limits: Limits = NO_LIMITS) -> InfoV5:
        """The description of the file. Raises BitstreamError, also for more Gaussians than the limit."""
        return InfoV5(**vars(super().info(file_bytes, checksum, limits)), short=self.is_short)

    def size_bits(self) -> dict[str, int]:
        """Bits spent on header and checksum, on texture, on alpha and on the payload, which mixes all attributes."""
        parts = {name: 8 * len(part) for name, part in self._parts().items()}
        return {"headers": 8 * self.file_bytes - sum(parts.values()), **parts}


def alpha_bytes(alpha: StreamV5) -> int:
    """Bytes that alpha takes in a file, at most."""
    return len(write_bits(list(replace(alpha, alpha=alpha)._header())[-3:], alpha.is_short)) + len(alpha.payload)
