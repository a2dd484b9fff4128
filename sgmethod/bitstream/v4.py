"""Version 4 of the file (profile rd): a short header, perhaps texture and alpha, then one entropy-coded payload.

Its shapes are clipped by no fineness of the steps, as those of version 3 were, and are drawn in a pyramid.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from sgmethod.bitstream import payload
from sgmethod.bitstream.fields import Field, Header
from sgmethod.bitstream.payload import (
    FLAG_GREY,
    FLAG_UPRIGHT,
    HEADER_BYTES,
    QUANTUM,
    CodedInfo,
    is_upright,
    quantum_code,
    quantum_of,
)
from sgmethod.bitstream.stream import NO_LIMITS, LaidOut, Limits
from sgmethod.bitstream.texture import Codes, pack, unpack
from sgmethod.errors import BitstreamError
from sgmethod.native import native
from sgmethod.scene import Gaussians, Scene, Texture

FLAG_TEXTURE, FLAG_ALPHA = 4, 8
HEADER = payload.header_of(FLAG_GREY | FLAG_UPRIGHT | FLAG_TEXTURE | FLAG_ALPHA)
ALPHA_HEADER = Header((QUANTUM, Field("background", 1, 0, 255), Field("bytes", 4, 0, 2**32 - 1)))  # of the payload


@dataclass(frozen=True, kw_only=True)
class InfoV4(CodedInfo):
    """Info of a version 4 file; gaussians: those of alpha too. The other fields as in StreamV4."""

    texture: bool
    alpha: bool


@dataclass(frozen=True)
class StreamV4:
    """A version 4 file. texture: codes of strengths [octaves, rows, columns], None without any; alpha: a grey picture
    of the same size without either, white where the picture is opaque, None where it is opaque everywhere; the other
    fields as in Coded (payload.py)."""

    VERSION: ClassVar[int] = 4
    MIN_BYTES: ClassVar[int] = HEADER_BYTES

    width: int
    height: int
    quantum: float
    background: tuple[int, int, int]
    grey: bool
    upright: bool
    payload: bytes
    texture: Codes | None = None
    alpha: StreamV4 | None = None

    @classmethod
    def of(
        cls,
        gaussians: Gaussians,
        size: tuple[int, int],
        quantum: float,
        background: tuple[int, int, int],
        grey: bool,
        with_shear: bool = False,
    ) -> StreamV4:
        """Quantise and code Gaussians over a picture of size (width, height). with_shear: even where none has any."""
        quantum = quantum_of(quantum_code(quantum))
        upright = is_upright(gaussians.factors, with_shear)
        parameters = native.RdParameters(*size, quantum, grey, upright, cls.VERSION)
        coded = native.rd_encode(parameters, gaussians.means, gaussians.factors, gaussians.colors)
        return cls(*size, quantum, background, grey, upright, coded)

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

    def gaussians(self, prefix: float = 1.0, limits: Limits = NO_LIMITS) -> Gaussians:
        """The Gaussians of the colours, largest first; with prefix < 1 those in that part of the payload.

        Raises BitstreamError, also for more Gaussians than the limit.
        """
        return payload.read_gaussians(self, prefix, limits)

    def lay_out(self, prefix: float = 1.0, texture: bool = True) -> LaidOut:
        """The whole picture's colours as they are drawn; texture: whether with theirs. Raises BitstreamError."""
        cell = native.TEXTURE_CELL
        drawn = native.Texture(self.texture, cell, cell) if texture and self.texture is not None else None
        return payload.lay_out(self, prefix, pyramid=True, texture=drawn)

    def scene(self, prefix: float = 1.0) -> Scene:
        """What is to be drawn, as far as that part of the payload tells; of alpha always all. Raises BitstreamError."""
        size, cell = (self.width, self.height), (native.TEXTURE_CELL, native.TEXTURE_CELL)
        texture = None if self.texture is None else Texture(self.texture, cell)
        alpha = None if self.alpha is None else self.alpha.scene()
        colours = Scene(self.gaussians(prefix), *size, self.background, native.CUTOFF_V3, pyramid=True)
        return replace(colours, texture=texture, alpha=alpha)

    def info(self, file_bytes: int, checksum: str, limits: Limits = NO_LIMITS) -> InfoV4:
        """The description of the file. Raises BitstreamError, also for more Gaussians than the limit."""
        gaussians = len(self.gaussians(limits=limits))
        if self.alpha is not None:
            left = None if limits.max_gaussians is None else limits.max_gaussians - gaussians
            gaussians += len(self.alpha.gaussians(limits=replace(limits, max_gaussians=left)))
        said = payload.info_of(self, gaussians, self.size_bits(), file_bytes, checksum)
        return InfoV4(**vars(said), texture=self.texture is not None, alpha=self.alpha is not None)

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
