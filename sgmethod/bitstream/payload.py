"""What versions 3 and 4 share: most of the header, and the way between a payload and the Gaussians in it.

Each function takes what a version says of itself (Coded). The payload's models are native (sgmethod/native/rd/);
docs/format.md describes them in words.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Protocol

from sgmethod.bitstream.fields import Field, Header
from sgmethod.bitstream.stream import OVERLAP, PREFIX_BYTES, Info, LaidOut, Limits
from sgmethod.errors import BitstreamError
from sgmethod.native import native
from sgmethod.scene import FloatArray, Gaussians

FLAG_GREY, FLAG_UPRIGHT = 1, 2
QUANTUM = Field("quantum", 2, 256, 3839, also=0)  # its code
MIN_QUANTUM, MAX_QUANTUM = 2.0**-10, 16.0


def header_of(most_flags: int) -> Header:
    """The header of a version whose flags come to that at most."""
    size = (Field(name, 2, 1, native.MAX_SIDE) for name in ("width", "height"))
    background = (Field(name, 1, 0, 255) for name in ("red", "green", "blue"))
    return Header((Field("flags", 1, 0, most_flags), *size, QUANTUM, *background))


HEADER_BYTES = PREFIX_BYTES + header_of(0).size


def quantum_code(quantum: float) -> int:
    """The 16-bit code of the nearest quantum: (1 + f / 256) 2^(4 - e), e in the high byte, f in the low."""
    quantum = min(max(quantum, MIN_QUANTUM), MAX_QUANTUM)
    exponent = math.floor(math.log2(quantum))
    fraction = round((quantum / 2.0**exponent - 1) * 256)
    if fraction == 256:
        exponent, fraction = exponent + 1, 0
    return (4 - exponent) << 8 | fraction


def quantum_of(code: int) -> float:
    """The quantum of a 16-bit code; exact in float64."""
    return (1 + (code & 0xFF) / 256) * 2.0 ** (4 - (code >> 8))


class Coded(Protocol):
    """A picture as a payload, with what a decoder must know of it.

    quantum: root of the picture energy (image in [0, 1], summed over pixels and channels) that one quantiser step
    of any parameter stands for; background: 8-bit RGB below all Gaussians; grey: no chroma in the payload;
    upright: no shear in it.
    """

    VERSION: ClassVar[int]

    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def quantum(self) -> float: ...
    @property
    def background(self) -> tuple[int, int, int]: ...
    @property
    def grey(self) -> bool: ...
    @property
    def upright(self) -> bool: ...
    @property
    def payload(self) -> bytes: ...


@dataclass(frozen=True, kw_only=True)
class CodedInfo(Info):
    """Info of a version 3 file, and most of a version 4 file's. The fields as in Coded."""

    quantum: float
    background: list[int]
    grey: bool
    upright: bool


Said = tuple[int, int, float, tuple[int, int, int], bool, bool]  # the fields of Coded but the payload


def read_header(header: Header, body: memoryview, limits: Limits) -> tuple[int, Said]:
    """The flags, and what else the header at the beginning of the body says. Raises BitstreamError."""
    said = header.read(body)
    flags, size, background = said["flags"], (said["width"], said["height"]), (said["red"], said["green"], said["blue"])
    limits.check_size(*size)
    return flags, (*size, quantum_of(said["quantum"]), background, bool(flags & FLAG_GREY), bool(flags & FLAG_UPRIGHT))


def write_header(header: Header, stream: Coded, more_flags: int = 0) -> bytes:
    """What read_header() reads."""
    flags = FLAG_GREY * stream.grey | FLAG_UPRIGHT * stream.upright | more_flags
    background = dict(zip(("red", "green", "blue"), stream.background, strict=True))
    size = {"width": stream.width, "height": stream.height}
    return header.write({"flags": flags, **size, "quantum": quantum_code(stream.quantum), **background})


def read_gaussians(stream: Coded, prefix: float, limits: Limits) -> Gaussians:
    """The Gaussians, largest first; with prefix < 1 those in that part of the payload.

    Raises BitstreamError, also for more Gaussians than the limit.
    """
    most = {} if limits.max_gaussians is None else {"max_gaussians": limits.max_gaussians}
    try:
        return Gaussians(*native.rd_decode(_parameters(stream), _part(stream, prefix), prefix < 1, **most))
    except RuntimeError as error:
        raise BitstreamError(f"the file is damaged: {error}") from error
    except OverflowError as error:
        raise BitstreamError(f"the file exceeds the limit of {limits.max_gaussians} Gaussians") from error


def lay_out(stream: Coded, prefix: float, pyramid: bool, texture: native.Texture | None = None) -> LaidOut:
    """The same as they are drawn, with their colours. Raises BitstreamError."""
    parameters, payload = _parameters(stream), _part(stream, prefix)
    try:
        return native.rd_lay_out(parameters, payload, prefix < 1, native.CUTOFF_V3, pyramid, texture)
    except RuntimeError as error:
        raise BitstreamError(f"the file is damaged: {error}") from error
    except OverflowError as error:
        raise BitstreamError(OVERLAP) from error


def _parameters(stream: Coded) -> native.RdParameters:
    size = stream.width, stream.height
    return native.RdParameters(*size, stream.quantum, stream.grey, stream.upright, stream.VERSION)


def _part(stream: Coded, prefix: float) -> bytes:
    return stream.payload[: math.ceil(prefix * len(stream.payload))]


def info_of(stream: Coded, gaussians: int, bits: dict[str, int], file_bytes: int, checksum: str) -> CodedInfo:
    """The description of a file with this many Gaussians."""
    return CodedInfo(
        bytes=file_bytes,
        bpp=8 * file_bytes / (stream.width * stream.height),
        version=stream.VERSION,
        checksum=checksum,
        profile="rd",
        width=stream.width,
        height=stream.height,
        gaussians=gaussians,
        quantum=stream.quantum,
        background=list(stream.background),
        grey=stream.grey,
        upright=stream.upright,
        bits=bits,
    )


def is_upright(factors: FloatArray, with_shear: bool) -> bool:
    """Whether a payload is without shear: where no factors [N, 3] have any, unless it is coded all the same."""
    return not with_shear and not bool(factors[:, 1].any())
