"""The interface of a file version: a stream that gives a scene to draw and a description of the file."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import ClassVar, Protocol

from sgmethod.errors import BitstreamError
from sgmethod.native import native
from sgmethod.scene import FloatArray, Scene

OVERLAP = "the file's Gaussians overlap beyond what a picture needs"
SIGNATURE, VERSION_ZERO = 0xD3, 0xC0  # the first byte; the second is this plus the version
SIGNATURE_BYTES = 2
MAGICS = tuple(bytes([SIGNATURE, VERSION_ZERO + version]) for version in range(1, 16))  # of files
SHORT_CHECKSUM, LONG_CHECKSUM = 1, 4  # bytes, the last of the CRC-32 of all that comes before them
LaidOut = tuple[native.Rasterization, FloatArray]  # Gaussians as they are drawn, and their colours


@dataclass(frozen=True)
class Limits:
    """Limits to what a file may claim before memory is allocated: pixels and Gaussians, None for no limit."""

    max_pixels: int | None = None
    max_gaussians: int | None = None

    def check_size(self, width: int, height: int) -> None:
        """Raise BitstreamError if a picture has more pixels than allowed."""
        if self.max_pixels is not None and width * height > self.max_pixels:
            raise BitstreamError(f"{width} x {height} pixels exceed the limit of {self.max_pixels}")


NO_LIMITS = Limits()


@dataclass(frozen=True, kw_only=True)
class Info:
    """Description of a file: its header, and how its bits are spent. Each format version adds its own fields.

    bytes: file size; bpp: bits per pixel; checksum: hexadecimal; bits: by part of the file, summing up to its size.
    """

    bytes: int
    bpp: float
    version: int
    checksum: str
    profile: str
    width: int
    height: int
    gaussians: int
    bits: dict[str, int]

    def to_dict(self) -> dict[str, object]:
        """Convert to plain JSON types, bits last."""
        fields = asdict(self)
        bits = fields.pop("bits")
        return {**fields, "bits": bits}


class Stream(Protocol):
    """A parsed file. Its body is the bytes between signature and checksum."""

    VERSION: ClassVar[int]
    MIN_BYTES: ClassVar[int]  # of a whole file

    @property
    def width(self) -> int:
        """Width of the picture in pixels."""

    @property
    def height(self) -> int:
        """Height of the picture in pixels."""

    @property
    def background(self) -> tuple[int, int, int]:
        """Background of the picture, 8-bit RGB."""

    @property
    def alpha(self) -> Stream | None:
        """Alpha as a grey picture of the same size, white where opaque; None if the whole picture is opaque."""

    @classmethod
    def parse(cls, body: memoryview, limits: Limits) -> Stream:
        """Parse a body. Raises BitstreamError."""

    def body(self) -> bytes:
        """Write the bytes between signature and checksum."""

    def scene(self, prefix: float = 1.0) -> Scene:
        """Return the scene to draw; with prefix < 1, only the Gaussians in that part of the file.

        Raises BitstreamError, and ViewError where there is no prefix.
        """

    def lay_out(self, prefix: float = 1.0, texture: bool = True) -> LaidOut | None:
        """Lay out the whole picture without alpha, faster than from scene(); None if only scene() can be drawn.

        texture: whether it is drawn, where there is any. Raises BitstreamError.
        """

    def info(self, file_bytes: int, checksum: str, limits: Limits = NO_LIMITS) -> Info:
        """Describe the file. Raises BitstreamError."""
