"""What every version of the file format gives: a stream, and from it a scene and a description of the file."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import ClassVar, Protocol

from sgmethod.errors import BitstreamError
from sgmethod.native import native
from sgmethod.scene import FloatArray, Scene

OVERLAP = "the file's Gaussians overlap beyond what a picture needs"
SIGNATURE, VERSION_ZERO = 0xD3, 0xC0  # the first byte; what a file's version is added to in the second
SIGNATURE_BYTES = 2
BEGINNINGS = b"\xd3\xc1", b"\xd3\xc2"  # of files that are known
SHORT_CHECKSUM, LONG_CHECKSUM = 1, 4  # bytes, the last of the CRC-32 of all that comes before them
LaidOut = tuple[native.Rasterization, FloatArray]  # Gaussians as they are drawn, and their colours


@dataclass(frozen=True)
class Limits:
    """What a file may claim before memory is taken for it: pixels of the picture, Gaussians; None for any number."""

    max_pixels: int | None = None
    max_gaussians: int | None = None

    def check_size(self, width: int, height: int) -> None:
        """Raise BitstreamError for a picture of more pixels."""
        if self.max_pixels is not None and width * height > self.max_pixels:
            raise BitstreamError(f"{width} x {height} pixels exceed the limit of {self.max_pixels}")


NO_LIMITS = Limits()


@dataclass(frozen=True, kw_only=True)
class Info:
    """The header of a file, and how its bits are spent. Each format version adds its own fields.

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
        """Plain JSON types, the bits last."""
        fields = asdict(self)
        return {**fields, "bits": fields.pop("bits")}


class Stream(Protocol):
    """A file without its signature and checksum, parsed. Its body is what is left of the bytes."""

    VERSION: ClassVar[int]
    MIN_BYTES: ClassVar[int]  # of a whole file

    @property
    def width(self) -> int:
        """Of the picture, pixels."""
        ...

    @property
    def height(self) -> int:
        """Of the picture, pixels."""
        ...

    @property
    def background(self) -> tuple[int, int, int]:
        """Of the picture, 8-bit RGB."""
        ...

    @property
    def alpha(self) -> Stream | None:
        """A grey picture of the same size, white where this one is opaque; None where it is opaque everywhere."""
        ...

    @classmethod
    def parse(cls, body: memoryview, limits: Limits) -> Stream:
        """From the body. Raises BitstreamError."""
        ...

    def body(self) -> bytes:
        """The bytes between signature and checksum."""
        ...

    def scene(self, prefix: float = 1.0) -> Scene:
        """What is to be drawn; with prefix < 1 as far as that part of the file tells.

        Raises BitstreamError, and ViewError where there is no prefix.
        """
        ...

    def lay_out(self, prefix: float = 1.0, texture: bool = True) -> LaidOut | None:
        """The whole picture without alpha as it is drawn, sooner than from scene(); None where that is the only way.

        texture: whether it is drawn, where there is any. Raises BitstreamError.
        """
        ...

    def info(self, file_bytes: int, checksum: str, limits: Limits = NO_LIMITS) -> Info:
        """The description of the file. Raises BitstreamError."""
        ...
