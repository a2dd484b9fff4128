"""What versions 3, 4 and 5 share: a picture as a payload, and the way between it and its Gaussians.

The payload's models are native (sgmethod/native/rd/); docs/format.md describes them in words.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from sgmethod.bitstream.fields import Field, Header
from sgmethod.bitstream.stream import NO_LIMITS, OVERLAP, PREFIX_BYTES, Info, LaidOut, Limits
from sgmethod.bitstream.texture import Codes
from sgmethod.errors import BitstreamError
from sgmethod.native import native
from sgmethod.scene import FloatArray, Gaussians, Scene, Texture

FLAG_GREY, FLAG_UPRIGHT, FLAG_TEXTURE, FLAG_ALPHA = 1, 2, 4, 8
QUANTUM = Field("quantum", 2, 256, 3839, also=0)  # its code
MIN_QUANTUM, MAX_QUANTUM = 2.0**-10, 16.0


def header_of(most_flags: int) -> Header:
    """The header of version 3 or 4, whose flags come to that at most."""
    size = (Field(name, 2, 1, native.MAX_SIDE) for name in ("width", "height"))
    background = (Field(name, 1, 0, 255) for name in ("red", "green", "blue"))
    return Header((Field("flags", 1, 0, most_flags), *size, QUANTUM, *background))


HEADER_BYTES = PREFIX_BYTES + header_of(0).size


def quantum_code(quantum: float) -> int:
    """The 16-bit code of the nearest quantum in versions 3 and 4: (1 + f / 256) 2^(4 - e), e in the high byte, f in the
    low."""
    quantum = min(max(quantum, MIN_QUANTUM), MAX_QUANTUM)
    exponent = math.floor(math.log2(quantum))
    fraction = round((quantum / 2.0**exponent - 1) * 256)
    if fraction == 256:
        exponent, fraction = exponent + 1, 0
    return (4 - exponent) << 8 | fraction


def quantum_of(code: int) -> float:
    """The quantum of a 16-bit code; exact in float64."""
    return (1 + (code & 0xFF) / 256) * 2.0 ** (4 - (code >> 8))


@dataclass(frozen=True, kw_only=True)
class CodedInfo(Info):
    """Info of a version 3 file, and most of a later one's; gaussians: those of alpha too. Fields as in CodedStream."""

    quantum: float
    background: list[int]
    grey: bool
    upright: bool


@dataclass(frozen=True, kw_only=True)
class TexturedInfo(CodedInfo):
    """Info of a version 4 file: whether it has texture, and alpha."""

    texture: bool
    alpha: bool


@dataclass(frozen=True)
class CodedStream:
    """A picture as a payload, with what a decoder must know of it.

    quantum: root of the picture energy (image in [0, 1], summed over pixels and channels) that one quantiser step
    of any parameter stands for; background: 8-bit RGB below all Gaussians; grey: no chroma in the payload;
    upright: no shear in it; texture: codes of strengths [octaves, rows, columns], None without any; alpha: a grey
    picture of the same size without either, white where the picture is opaque, None where it is opaque everywhere;
    is_short: the payload's lanes share a state (version 5).
    """

    VERSION: ClassVar[int]
    CODING: ClassVar[int] = 4  # the version that wrote such payloads first
    HAS_BANDED_TEXTURE: ClassVar[bool] = False

    width: int
    height: int
    quantum: float
    background: tuple[int, int, int]
    grey: bool
    upright: bool
    payload: bytes
    texture: Codes | None = None
    alpha: Self | None = None
    is_short: bool = False

    @classmethod
    def of(
        cls,
        gaussians: Gaussians,
        size: tuple[int, int],
        quantum: float,
        background: tuple[int, int, int],
        grey: bool,
        with_shear: bool = False,
        is_short: bool = False,
    ) -> Self:
        """Quantise and code Gaussians over a picture of size (width, height). with_shear: even where none has any."""
        upright = is_upright(gaussians.factors, with_shear)
        coded = cls.coded_quantum(quantum, is_short)
        stream = cls(*size, coded, background, grey, upright, b"", is_short=is_short)
        return replace(stream, payload=native.rd_encode(stream._parameters(), *gaussians.arrays))

    @staticmethod
    def coded_quantum(quantum: float, is_short: bool = False) -> float:
        """The nearest quantum that a file can hold."""
        del is_short
        return quantum_of(quantum_code(quantum))

    def _parameters(self) -> native.RdParameters:
        size = self.width, self.height
        return native.RdParameters(*size, self.quantum, self.grey, self.upright, self.CODING, self.is_short)

    def _part(self, prefix: float) -> bytes:
        return self.payload[: math.ceil(prefix * len(self.payload))]

    def gaussians(self, prefix: float = 1.0, limits: Limits = NO_LIMITS) -> Gaussians:
        """The Gaussians of the colours, largest first; with prefix < 1 those in that part of the payload.

        Raises BitstreamError, also for more Gaussians than the limit.
        """
        most = {} if limits.max_gaussians is None else {"max_gaussians": limits.max_gaussians}
        try:
            return Gaussians(*native.rd_decode(self._parameters(), self._part(prefix), prefix < 1, **most))
        except RuntimeError as error:
            raise BitstreamError(f"the file is damaged: {error}") from error
        except OverflowError as error:
            raise BitstreamError(f"the file exceeds the limit of {limits.max_gaussians} Gaussians") from error

    def lay_out(self, prefix: float = 1.0, texture: bool = True) -> LaidOut:
        """The whole picture's colours as they are drawn; texture: whether with theirs. Raises BitstreamError."""
        drawn = None
        if texture and self.texture is not None:
            sides = native.TEXTURE_CELL, native.TEXTURE_CELL
            drawn = native.Texture(self.texture, *sides, is_banded=self.HAS_BANDED_TEXTURE)
        parameters, pyramid = self._parameters(), self.CODING >= 4
        try:
            return native.rd_lay_out(parameters, self._part(prefix), prefix < 1, native.CUTOFF_V3, pyramid, drawn)
        except RuntimeError as error:
            raise BitstreamError(f"the file is damaged: {error}") from error
        except OverflowError as error:
            raise BitstreamError(OVERLAP) from error

    def scene(self, prefix: float = 1.0) -> Scene:
        """What is to be drawn, as far as that part of the payload tells; of alpha always all. Raises BitstreamError."""
        size, cell = (self.width, self.height), (native.TEXTURE_CELL, native.TEXTURE_CELL)
        texture = None if self.texture is None else Texture(self.texture, cell, is_banded=self.HAS_BANDED_TEXTURE)
        alpha = None if self.alpha is None else self.alpha.scene()
        colours = Scene(self.gaussians(prefix), *size, self.background, native.CUTOFF_V3, pyramid=self.CODING >= 4)
        return replace(colours, texture=texture, alpha=alpha)

    def info(self, file_bytes: int, checksum: str, limits: Limits = NO_LIMITS) -> CodedInfo:
        """The description of the file. Raises BitstreamError, also for more Gaussians than the limit."""
        gaussians = len(self.gaussians(limits=limits))
        if self.alpha is not None:
            left = None if limits.max_gaussians is None else limits.max_gaussians - gaussians
            gaussians += len(self.alpha.gaussians(limits=replace(limits, max_gaussians=left)))
        info = CodedInfo(
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
            bits=self.size_bits(),
        )
        if self.CODING < 4:
            return info
        return TexturedInfo(**vars(info), texture=self.texture is not None, alpha=self.alpha is not None)

    def size_bits(self) -> dict[str, int]:
        """Bits spent on each part of the file."""
        raise NotImplementedError


Said = tuple[int, int, float, tuple[int, int, int], bool, bool]  # the fields of CodedStream up to the payload


def read_header(header: Header, body: memoryview, limits: Limits) -> tuple[int, Said]:
    """The flags, and what else the header of version 3 or 4 that begins the body says. Raises BitstreamError."""
    said = header.read(body)
    flags, size, background = said["flags"], (said["width"], said["height"]), (said["red"], said["green"], said["blue"])
    limits.check_size(*size)
    return flags, (*size, quantum_of(said["quantum"]), background, bool(flags & FLAG_GREY), bool(flags & FLAG_UPRIGHT))


def write_header(header: Header, stream: CodedStream, more_flags: int = 0) -> bytes:
    """What read_header() reads."""
    flags = FLAG_GREY * stream.grey | FLAG_UPRIGHT * stream.upright | more_flags
    background = dict(zip(("red", "green", "blue"), stream.background, strict=True))
    size = {"width": stream.width, "height": stream.height}
    return header.write({"flags": flags, **size, "quantum": quantum_code(stream.quantum), **background})


def is_upright(factors: FloatArray, with_shear: bool) -> bool:
    """Whether a payload is without shear: where no factors [N, 3] have any, unless it is coded all the same."""
    return not with_shear and not bool(factors[:, 1].any())
