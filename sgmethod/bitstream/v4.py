"""Version 4 of the file (profile rd), a draft: version 3 with shapes that no fineness of the steps clips, drawn in a
pyramid, and perhaps with texture. Until it is fixed, a file of version 4 is read by the release that wrote it alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

from sgmethod.bitstream.stream import NO_LIMITS, Limits
from sgmethod.bitstream.texture import Codes, pack, unpack
from sgmethod.bitstream.v3 import FLAG_GREY, FLAG_UPRIGHT, HEADER, InfoV3, StreamV3
from sgmethod.native import native
from sgmethod.scene import FloatArray, Scene, Texture

FLAG_TEXTURE = 4


@dataclass(frozen=True, kw_only=True)
class InfoV4(InfoV3):
    """Info of a version 4 file. The other fields as in StreamV4."""

    texture: bool


@dataclass(frozen=True)
class StreamV4(StreamV3):
    """A version 4 file. texture: codes of strengths [octaves, rows, columns], None without any; the other fields are
    those of StreamV3."""

    VERSION: ClassVar[int] = 4
    FLAGS: ClassVar[int] = FLAG_GREY | FLAG_UPRIGHT | FLAG_TEXTURE

    texture: Codes | None = None

    @classmethod
    def parse(cls, body: memoryview, limits: Limits = NO_LIMITS) -> Self:
        """From what follows the checksum. The payload is not looked at. Raises BitstreamError."""
        stream = super().parse(body, limits)
        if not body[0] & FLAG_TEXTURE:
            return stream
        codes, length = unpack(stream.payload, stream.width, stream.height)
        return replace(stream, texture=codes, payload=stream.payload[length:])

    def body(self) -> bytes:
        """What follows the checksum."""
        body = super().body()
        if self.texture is None:
            return body
        return body[: HEADER.size] + pack(self.texture) + self.payload

    def _flags(self) -> int:
        return super()._flags() | FLAG_TEXTURE * (self.texture is not None)

    def lay_out(self, prefix: float = 1.0, texture: bool = True) -> tuple[native.Rasterization, FloatArray]:
        """As that of version 3."""
        cell = native.TEXTURE_CELL
        drawn = native.Texture(self.texture, cell, cell) if texture and self.texture is not None else None
        return self._laid_out(prefix, pyramid=True, texture=drawn)

    def scene(self, prefix: float = 1.0) -> Scene:
        """What is to be drawn, as far as that part of the payload tells. Raises BitstreamError."""
        drawn = None if self.texture is None else Texture(self.texture, (native.TEXTURE_CELL, native.TEXTURE_CELL))
        return replace(super().scene(prefix), pyramid=True, texture=drawn)

    def info(self, file_bytes: int, checksum: str, limits: Limits = NO_LIMITS) -> InfoV4:
        """The description of the file. Raises BitstreamError, also for more Gaussians than the limit."""
        return InfoV4(**vars(super().info(file_bytes, checksum, limits)), texture=self.texture is not None)

    def size_bits(self) -> dict[str, int]:
        """Bits spent on the header, on texture and on the payload, which mixes all attributes."""
        packed = b"" if self.texture is None else pack(self.texture)
        return {"headers": super().size_bits()["headers"], "texture": 8 * len(packed), "payload": 8 * len(self.payload)}
