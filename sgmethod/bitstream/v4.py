"""Version 4 of the file (profile rd): version 3 with shapes that no fineness of the steps clips, drawn in a pyramid,
and perhaps with texture and alpha.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from sgmethod.bitstream.stream import NO_LIMITS, Limits
from sgmethod.bitstream.texture import Codes, pack, unpack
from sgmethod.bitstream.v3 import FLAG_GREY, FLAG_UPRIGHT, HEADER, InfoV3, StreamV3, checked_quantum, quantum_code
from sgmethod.errors import BitstreamError
from sgmethod.native import native
from sgmethod.scene import FloatArray, Scene, Texture

FLAG_TEXTURE, FLAG_ALPHA = 4, 8
ALPHA_HEADER = struct.Struct(">HBI")  # quantum code, background, bytes of the payload


@dataclass(frozen=True, kw_only=True)
class InfoV4(InfoV3):
    """Info of a version 4 file; gaussians: those of alpha too. The other fields as in StreamV4."""

    texture: bool
    alpha: bool


@dataclass(frozen=True)
class StreamV4(StreamV3):
    """A version 4 file. texture: codes of strengths [octaves, rows, columns], None without any; alpha: a grey picture
    of the same size without either, white where the picture is opaque, None where it is opaque everywhere; the other
    fields are those of StreamV3."""

    VERSION: ClassVar[int] = 4
    FLAGS: ClassVar[int] = FLAG_GREY | FLAG_UPRIGHT | FLAG_TEXTURE | FLAG_ALPHA

    texture: Codes | None = None
    alpha: StreamV4 | None = None

    @classmethod
    def parse(cls, body: memoryview, limits: Limits = NO_LIMITS) -> Self:
        """From what follows the checksum. The payloads are not looked at. Raises BitstreamError."""
        stream = super().parse(body, limits)
        if body[0] & FLAG_TEXTURE:
            codes, length = unpack(stream.payload, stream.width, stream.height)
            stream = replace(stream, texture=codes, payload=stream.payload[length:])
        if body[0] & FLAG_ALPHA:
            alpha, length = _unpack_alpha(stream)
            stream = replace(stream, alpha=alpha, payload=stream.payload[length:])
        return stream

    def body(self) -> bytes:
        """What follows the checksum."""
        header = super().body()[: HEADER.size]
        return header + self._texture_part() + self._alpha_part() + self.payload

    def _texture_part(self) -> bytes:
        return b"" if self.texture is None else pack(self.texture)

    def _alpha_part(self) -> bytes:
        return b"" if self.alpha is None else _pack_alpha(self.alpha)

    def _flags(self) -> int:
        kinds = FLAG_TEXTURE * (self.texture is not None) | FLAG_ALPHA * (self.alpha is not None)
        return super()._flags() | kinds

    def lay_out(self, prefix: float = 1.0, texture: bool = True) -> tuple[native.Rasterization, FloatArray]:
        """As that of version 3; of the colours, without alpha."""
        cell = native.TEXTURE_CELL
        drawn = native.Texture(self.texture, cell, cell) if texture and self.texture is not None else None
        return self._laid_out(prefix, pyramid=True, texture=drawn)

    def scene(self, prefix: float = 1.0) -> Scene:
        """What is to be drawn, as far as that part of the payload tells; of alpha always all. Raises BitstreamError."""
        drawn = None if self.texture is None else Texture(self.texture, (native.TEXTURE_CELL, native.TEXTURE_CELL))
        alpha = None if self.alpha is None else self.alpha.scene()
        return replace(super().scene(prefix), pyramid=True, texture=drawn, alpha=alpha)

    def info(self, file_bytes: int, checksum: str, limits: Limits = NO_LIMITS) -> InfoV4:
        """The description of the file. Raises BitstreamError, also for more Gaussians than the limit."""
        said = vars(super().info(file_bytes, checksum, limits))
        if self.alpha is not None:
            left = None if limits.max_gaussians is None else limits.max_gaussians - said["gaussians"]
            said["gaussians"] += len(self.alpha.gaussians(limits=replace(limits, max_gaussians=left)))
        return InfoV4(**said, texture=self.texture is not None, alpha=self.alpha is not None)

    def size_bits(self) -> dict[str, int]:
        """Bits spent on the header, on texture, on alpha and on the payload, which mixes all attributes."""
        bits = {"headers": super().size_bits()["headers"], "texture": 8 * len(self._texture_part())}
        return {**bits, "alpha": 8 * len(self._alpha_part()), "payload": 8 * len(self.payload)}


def _pack_alpha(alpha: StreamV4) -> bytes:
    """The alpha part's bytes: what is not the same as in the picture. It has no flags: alpha is grey, and has shear."""
    assert not alpha.payload or (alpha.grey and not alpha.upright)
    return ALPHA_HEADER.pack(quantum_code(alpha.quantum), alpha.background[0], len(alpha.payload)) + alpha.payload


def _unpack_alpha(stream: StreamV4) -> tuple[StreamV4, int]:
    """The alpha at the beginning of a picture's payload, and how many bytes it took. Raises BitstreamError."""
    data, size = stream.payload, ALPHA_HEADER.size
    if len(data) < size:
        raise BitstreamError("the file is damaged: its alpha is cut short")
    code, level, length = ALPHA_HEADER.unpack(data[:size])
    if len(data) < size + length:
        raise BitstreamError("the file is damaged: its alpha is cut short")
    quantum = checked_quantum(code)
    payload = data[size : size + length]
    return StreamV4(stream.width, stream.height, quantum, (level,) * 3, True, False, payload), size + length
