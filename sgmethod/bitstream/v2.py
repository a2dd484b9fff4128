"""Version 2 of the file (profile rd): a header of a few bytes, perhaps texture and alpha, an entropy-coded payload.

A file of up to SHORT_BYTES may be short: some fields of its header have fewer bits, its checksum is one byte, and its
payloads use one coder state instead of two. The payload's models are native (sgmethod/native/rd/); docs/format.md
describes everything in words.
"""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import ClassVar

from sgmethod.bitstream.fields import BitField, BitReader, write_bits
from sgmethod.bitstream.stream import (
    LONG_CHECKSUM,
    NO_LIMITS,
    OVERLAP,
    SHORT_CHECKSUM,
    SIGNATURE_BYTES,
    Info,
    LaidOut,
    Limits,
)
from sgmethod.bitstream.texture import Codes, pack, unpack
from sgmethod.errors import BitstreamError
from sgmethod.native import native
from sgmethod.scene import FloatArray, Gaussians, Scene, Texture

FLAG_GREY, FLAG_UPRIGHT, FLAG_TEXTURE, FLAG_ALPHA = 1, 2, 4, 8
FLAG_SHORT = 16  # the first bit after the signature
FLAGS = BitField("flags", 5, 5)
SIZE = BitField("width", 4, 4, grows=True), BitField("height", 4, 4, grows=True)
QUANTUM = BitField("quantum", 12, 8)  # its code
BACKGROUND = BitField("red", 8, 5), BitField("green", 8, 5), BitField("blue", 8, 5)
ALPHA_BYTES = BitField("alpha_bytes", 5, 5, grows=True)  # of its payload, and 1
HEADER = (FLAGS, *SIZE, QUANTUM, *BACKGROUND)
ALPHA_HEADER = (BitField("alpha_quantum", 12, 8), BitField("alpha_background", 8, 5), ALPHA_BYTES)
MIN_QUANTUM, MAX_QUANTUM = 2.0**-10, 16.0
SHORT_BYTES = 1024  # largest short file that the encoder writes: beyond, a short header saves less than half a percent
SMALLEST_FILE, SMALLEST_ALPHA = 12, 3  # bytes without Gaussians: of the largest picture, and of opaque alpha


def smallest_file(_: object, has_alpha: bool) -> int:
    """Bytes of the smallest file for the largest picture."""
    return SMALLEST_FILE + has_alpha * SMALLEST_ALPHA


def quantum_of(code: int) -> float:
    """Decode a quantum, (1 + f / 256) 2^(3 - e) with e the upper four bits and f the lower eight; exact in float64."""
    return (1 + (code & 0xFF) / 256) * 2.0 ** (3 - (code >> 8))


@cache
def _short_codes() -> tuple[dict[float, int], list[float]]:
    """Codes of the quanta that a short file can hold, and these in ascending order."""
    codes = (QUANTUM.value(upper) for upper in range(2**QUANTUM.short_bits))
    found = {quantum_of(code): code for code in codes if quantum_of(code) >= MIN_QUANTUM}
    return found, sorted(found)


def quantum_code(quantum: float, is_short: bool = False) -> int:
    """Return the code of the nearest quantum."""
    if is_short:
        codes, quanta = _short_codes()
        at = bisect(quanta, quantum)
        near = sorted(codes[one] for one in quanta[max(at - 1, 0) : at + 1])
        return min(near, key=lambda code: abs(quantum_of(code) - quantum))
    quantum = min(max(quantum, MIN_QUANTUM), quantum_of(255))
    exponent = math.floor(math.log2(quantum))
    fraction = round((quantum / 2.0**exponent - 1) * 256)
    return (3 - exponent - fraction // 256) << 8 | fraction % 256


def coded_background(background: tuple[int, int, int], is_short: bool) -> tuple[int, int, int]:
    """Return the nearest colour that a file can hold."""
    if not is_short:
        return background
    levels = [BACKGROUND[0].value(upper) for upper in range(2 ** BACKGROUND[0].short_bits)]
    red, green, blue = (min(levels, key=lambda level: abs(level - own)) for own in background)
    return red, green, blue


def is_upright(factors: FloatArray, with_shear: bool) -> bool:
    """Whether a payload leaves out shear: no factor [N, 3] has shear, and the caller does not ask for it."""
    return not with_shear and not bool(factors[:, 1].any())


@dataclass(frozen=True, kw_only=True)
class InfoV2(Info):
    """Description of a version 2 file.

    gaussians: includes the Gaussians of alpha; texture, alpha: whether the file has any; short: whether it is a short
    file. The other fields are the same as in StreamV2.
    """

    quantum: float
    background: list[int]
    grey: bool
    upright: bool
    texture: bool
    alpha: bool
    short: bool


@dataclass(frozen=True)
class StreamV2:
    """A version 2 file: a picture as a payload, with what a decoder must know of it.

    quantum: root of the picture energy (image in [0, 1], summed over pixels and channels) that one quantiser step
    of any parameter stands for; background: 8-bit RGB below all Gaussians; grey: no chroma in the payload;
    upright: no shear in it; texture: codes of strengths [octaves, rows, columns], None without any; alpha: a grey
    picture of the same size without either, white where the picture is opaque, None where it is opaque everywhere;
    is_short: all symbols of the payload share a state.
    """

    VERSION: ClassVar[int] = 2
    MIN_BYTES: ClassVar[int] = SIGNATURE_BYTES + 4 + SHORT_CHECKSUM  # a short one of a grey pixel

    width: int
    height: int
    quantum: float
    background: tuple[int, int, int]
    grey: bool
    upright: bool
    payload: bytes
    texture: Codes | None = None
    alpha: StreamV2 | None = None
    is_short: bool = False

    @classmethod
    def from_gaussians(
        cls,
        gaussians: Gaussians,
        size: tuple[int, int],
        quantum: float,
        background: tuple[int, int, int],
        grey: bool,
        with_shear: bool = False,
        is_short: bool = False,
    ) -> StreamV2:
        """Quantise and code Gaussians over a picture of size (width, height). with_shear: even where none has any."""
        upright = is_upright(gaussians.factors, with_shear)
        coded = cls.coded_quantum(quantum, is_short)
        stream = cls(*size, coded, background, grey, upright, b"", is_short=is_short)
        return replace(stream, payload=native.rd_encode(stream._parameters(), *gaussians.arrays))

    @staticmethod
    def coded_quantum(quantum: float, is_short: bool = False) -> float:
        """Return the nearest quantum that a file can hold."""
        return quantum_of(quantum_code(quantum, is_short))

    @classmethod
    def parse(cls, body: memoryview, limits: Limits = NO_LIMITS) -> StreamV2:
        """Read the bytes between signature and checksum, except the payloads. Raises BitstreamError."""
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

    def body(self) -> bytes:
        """Write the bytes between signature and checksum."""
        if self.alpha is not None and self.alpha.payload:
            assert (self.alpha.grey, self.alpha.upright, self.alpha.is_short) == (True, False, self.is_short)
        return write_bits(self._header(), self.is_short) + b"".join(self._parts().values())

    def _header(self) -> Iterator[tuple[BitField, int]]:
        """Yield each field of the header and its value."""
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
        """Parts after the header. Alpha has no flags of its own: it is grey, has shear, and is short if the file is."""
        texture = b"" if self.texture is None else pack(self.texture)
        return {"texture": texture, "alpha": b"" if self.alpha is None else self.alpha.payload, "payload": self.payload}

    @property
    def file_bytes(self) -> int:
        """Size of the whole file."""
        return SIGNATURE_BYTES + len(self.body()) + (SHORT_CHECKSUM if self.is_short else LONG_CHECKSUM)

    def _parameters(self) -> native.RdParameters:
        return native.RdParameters(self.width, self.height, self.quantum, self.grey, self.upright, self.is_short)

    def _part(self, prefix: float) -> bytes:
        return self.payload[: math.ceil(prefix * len(self.payload))]

    def gaussians(self, prefix: float = 1.0, limits: Limits = NO_LIMITS, others: int = 0) -> Gaussians:
        """Decode the Gaussians of the colours, largest first; with prefix < 1, those in that part of the payload.

        Raises BitstreamError, also if they and the `others` are more than the limit.
        """
        limit = {} if limits.max_gaussians is None else {"max_gaussians": limits.max_gaussians - others}
        try:
            return Gaussians(*native.rd_decode(self._parameters(), self._part(prefix), prefix < 1, **limit))
        except RuntimeError as error:
            raise BitstreamError(f"the file is damaged: {error}") from error
        except OverflowError as error:
            raise BitstreamError(f"the file exceeds the limit of {limits.max_gaussians} Gaussians") from error

    def lay_out(self, prefix: float = 1.0, texture: bool = True) -> LaidOut:
        """Lay out the whole picture without alpha, with or without texture. Raises BitstreamError."""
        drawn = None
        if texture and self.texture is not None:
            drawn = native.Texture(self.texture, native.TEXTURE_CELL, native.TEXTURE_CELL)
        try:
            return native.rd_lay_out(self._parameters(), self._part(prefix), prefix < 1, drawn)
        except RuntimeError as error:
            raise BitstreamError(f"the file is damaged: {error}") from error
        except OverflowError as error:
            raise BitstreamError(OVERLAP) from error

    def scene(self, prefix: float = 1.0) -> Scene:
        """Return the scene to draw, from that part of the payload and all of alpha. Raises BitstreamError."""
        size, cell = (self.width, self.height), (native.TEXTURE_CELL, native.TEXTURE_CELL)
        texture = None if self.texture is None else Texture(self.texture, cell)
        alpha = None if self.alpha is None else self.alpha.scene()
        colours = Scene(self.gaussians(prefix), *size, self.background, native.CUTOFF_V2, pyramid=True)
        return replace(colours, texture=texture, alpha=alpha)

    def info(self, file_bytes: int, checksum: str, limits: Limits = NO_LIMITS) -> InfoV2:
        """Describe the file. Raises BitstreamError, also for more Gaussians than the limit."""
        gaussians = len(self.gaussians(limits=limits))
        if self.alpha is not None:
            gaussians += len(self.alpha.gaussians(limits=limits, others=gaussians))
        return InfoV2(
            bytes=file_bytes,
            bpp=8 * file_bytes / (self.width * self.height),
            version=self.VERSION,
            checksum=checksum,
            profile="rd",
            width=self.width,
            height=self.height,
            gaussians=gaussians,
            quantum=self.quantum,
            background=list(self.background),
            grey=self.grey,
            upright=self.upright,
            texture=self.texture is not None,
            alpha=self.alpha is not None,
            short=self.is_short,
            bits=self.size_bits(),
        )

    def size_bits(self) -> dict[str, int]:
        """Bits of header and checksum, texture, alpha, and payload, which mixes all attributes."""
        parts = {name: 8 * len(part) for name, part in self._parts().items()}
        return {"headers": 8 * self.file_bytes - sum(parts.values()), **parts}


def alpha_bytes(alpha: StreamV2) -> int:
    """Most bytes that alpha takes in a file."""
    return len(write_bits(list(replace(alpha, alpha=alpha)._header())[-3:], alpha.is_short)) + len(alpha.payload)
