"""Version 3 of the file (profile rd): a short header, then one entropy-coded payload.

The payload's model is native (sgmethod/native/rd/models_v3.h), written once for both directions. docs/format.md
describes both in words.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from sgmethod.bitstream.stream import NO_LIMITS, OVERLAP, PREFIX_BYTES, Info, Limits
from sgmethod.errors import BitstreamError
from sgmethod.native import native
from sgmethod.scene import FloatArray, Gaussians, Scene

HEADER = struct.Struct(">BHHH3B")  # flags, width, height, quantum code, background
HEADER_BYTES = PREFIX_BYTES + HEADER.size
FLAG_GREY, FLAG_UPRIGHT = 1, 2
MIN_QUANTUM, MAX_QUANTUM = 2.0**-10, 16.0


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


def checked_quantum(code: int) -> float:
    """The same of a file's code. Raises BitstreamError."""
    quantum = quantum_of(code)
    if not MIN_QUANTUM <= quantum <= MAX_QUANTUM:
        raise BitstreamError(f"header field quantum is {quantum}, outside {MIN_QUANTUM} .. {MAX_QUANTUM}")
    return quantum


@dataclass(frozen=True, kw_only=True)
class InfoV3(Info):
    """Info of a version 3 file. The other fields as in StreamV3."""

    quantum: float
    background: list[int]
    grey: bool
    upright: bool


@dataclass(frozen=True)
class StreamV3:
    """A version 3 file.

    quantum: root of the picture energy (image in [0, 1], summed over pixels and channels) that one quantiser step
    of any parameter stands for; background: 8-bit RGB below all Gaussians; grey: no chroma in the payload;
    upright: no shear in it.
    """

    VERSION: ClassVar[int] = 3
    MIN_BYTES: ClassVar[int] = HEADER_BYTES
    FLAGS: ClassVar[int] = FLAG_GREY | FLAG_UPRIGHT

    width: int
    height: int
    quantum: float
    background: tuple[int, int, int]
    grey: bool
    upright: bool
    payload: bytes

    @classmethod
    def of(
        cls,
        gaussians: Gaussians,
        size: tuple[int, int],
        quantum: float,
        background: tuple[int, int, int],
        grey: bool,
        with_shear: bool = False,
    ) -> Self:
        """Quantise and code Gaussians over a picture of size (width, height). with_shear: even where none has any."""
        quantum = quantum_of(quantum_code(quantum))
        upright = is_upright(gaussians.factors, with_shear)
        parameters = native.RdParameters(*size, quantum, grey, upright, cls.VERSION)
        payload = native.rd_encode(parameters, gaussians.means, gaussians.factors, gaussians.colors)
        return cls(*size, quantum, background, grey, upright, payload)

    @classmethod
    def parse(cls, body: memoryview, limits: Limits = NO_LIMITS) -> Self:
        """From what follows the checksum. The payload is not looked at. Raises BitstreamError."""
        flags, width, height, code, *background = HEADER.unpack(body[: HEADER.size])
        if width == 0 or height == 0:
            raise BitstreamError(f"the picture's size is {width} x {height}")
        if flags > cls.FLAGS:
            raise BitstreamError(f"header field flags is {flags}, which this version does not know")
        quantum = checked_quantum(code)
        limits.check_size(width, height)
        red, green, blue = background
        grey, upright = bool(flags & FLAG_GREY), bool(flags & FLAG_UPRIGHT)
        return cls(width, height, quantum, (red, green, blue), grey, upright, bytes(body[HEADER.size :]))

    def body(self) -> bytes:
        """What follows the checksum."""
        code = quantum_code(self.quantum)
        return HEADER.pack(self._flags(), self.width, self.height, code, *self.background) + self.payload

    def _flags(self) -> int:
        return FLAG_GREY * self.grey | FLAG_UPRIGHT * self.upright

    def gaussians(self, prefix: float = 1.0, limits: Limits = NO_LIMITS) -> Gaussians:
        """The Gaussians, largest first; with prefix < 1 those in that part of the payload.

        Raises BitstreamError, also for more Gaussians than the limit.
        """
        most = {} if limits.max_gaussians is None else {"max_gaussians": limits.max_gaussians}
        try:
            return Gaussians(*native.rd_decode(self._parameters(), self._part(prefix), prefix < 1, **most))
        except RuntimeError as error:
            raise BitstreamError(f"the file is damaged: {error}") from error
        except OverflowError as error:
            raise BitstreamError(f"the file has more Gaussians than the limit of {limits.max_gaussians}") from error

    def _parameters(self) -> native.RdParameters:
        return native.RdParameters(self.width, self.height, self.quantum, self.grey, self.upright, self.VERSION)

    def _part(self, prefix: float) -> bytes:
        return self.payload[: math.ceil(prefix * len(self.payload))]

    def lay_out(self, prefix: float = 1.0, texture: bool = True) -> tuple[native.Rasterization, FloatArray]:
        """The whole picture's Gaussians as they are drawn, and their colours, in less time than from scene(). texture:
        whether it is drawn with them, if there is any. Raises BitstreamError."""
        del texture
        return self._laid_out(prefix, pyramid=False, texture=None)

    def _laid_out(
        self, prefix: float, pyramid: bool, texture: native.Texture | None
    ) -> tuple[native.Rasterization, FloatArray]:
        payload = self._part(prefix)
        try:
            return native.rd_lay_out(self._parameters(), payload, prefix < 1, native.CUTOFF_V3, pyramid, texture)
        except RuntimeError as error:
            raise BitstreamError(f"the file is damaged: {error}") from error
        except OverflowError as error:
            raise BitstreamError(OVERLAP) from error

    def scene(self, prefix: float = 1.0) -> Scene:
        """What is to be drawn, as far as that part of the payload tells. Raises BitstreamError."""
        return Scene(self.gaussians(prefix), self.width, self.height, self.background, native.CUTOFF_V3)

    def info(self, file_bytes: int, checksum: str, limits: Limits = NO_LIMITS) -> InfoV3:
        """The description of the file. Raises BitstreamError, also for more Gaussians than the limit."""
        return InfoV3(
            bytes=file_bytes,
            bpp=8 * file_bytes / (self.width * self.height),
            version=self.VERSION,
            checksum=checksum,
            profile="rd",
            width=self.width,
            height=self.height,
            gaussians=len(self.gaussians(limits=limits)),
            quantum=self.quantum,
            background=list(self.background),
            grey=self.grey,
            upright=self.upright,
            bits=self.size_bits(),
        )

    def size_bits(self) -> dict[str, int]:
        """Bits spent on the header and on the payload, which mixes all attributes."""
        return {"headers": 8 * HEADER_BYTES, "payload": 8 * len(self.payload)}


def is_upright(factors: FloatArray, with_shear: bool) -> bool:
    """Whether a payload is without shear: where no factors [N, 3] have any, unless it is coded all the same."""
    return not with_shear and not bool(factors[:, 1].any())


def background_of(pixels: NDArray[np.uint8]) -> tuple[int, int, int]:
    """The colour of more than half of an image [H, W, 3], such as a page's white, or the mean of all."""
    number = pixels.shape[0] * pixels.shape[1]
    counts = [np.bincount(channel.ravel(), minlength=256) for channel in np.moveaxis(pixels, 2, 0)]
    most = np.array([count.argmax() for count in counts], np.uint8)
    if min(count.max() for count in counts) > number / 2 and (pixels == most).all(2).sum() > number / 2:
        red, green, blue = (int(level) for level in most)
    else:
        red, green, blue = (round(float(count @ np.arange(256) / number)) for count in counts)
    return red, green, blue
