"""Parsers for parts of image files that Pillow does not expose, or misreads.

PNG's chunks, the profile of BMP, the boxes of AVIF and JPEG XL, the header of JPEG XL, the orientation in EXIF data.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
PNG_ANCILLARY = (b"tEXt", b"zTXt", b"iTXt", b"iCCP")

BMP_V5, BMP_EMBEDDED = 124, b"DEBM"  # size of the header; colour space PROFILE_EMBEDDED

EXIF_MARKS = re.compile(rb"^(Exif\0\0)*")  # some writers put it there twice
ORIENTATION = 274

MAX_BOXES = 1 << 16

Span = tuple[bytes, int, int]  # kind, start and end of the content
Box = tuple[int, int, int, int]  # x0, y0, x1, y1

JPEG_XL_MAGICS = (b"\xff\x0a", b"\0\0\0\x0cJXL \r\n\x87\n")  # bare codestream; codestream in boxes
# ISO/IEC 18181-1: two bits choose a pair: the width in bits of the number that follows, and the offset added to it.
SIDES = ((9, 1), (13, 1), (18, 1), (30, 1))
DEPTHS = ((0, 8), (0, 10), (0, 12), (6, 1))
RATIOS = ((1, 1), (12, 10), (4, 3), (3, 2), (16, 9), (5, 4), (2, 1))


class JpegXl(NamedTuple):
    """The header of a JPEG XL: size in pixels as displayed, whether it is animated, bits per sample."""

    width: int
    height: int
    is_animated: bool
    depth: int


def png_chunks(data: bytes) -> dict[bytes, bytes]:
    """Find the chunks cICP, iCCP, tRNS and eXIf. Pillow finds an eXIf after the pixels only after decoding them."""
    found: dict[bytes, bytes] = {}
    for kind, start, end in _chunks(data):
        if kind in (b"cICP", b"iCCP", b"tRNS", b"eXIf"):
            found.setdefault(kind, data[start:end])
    return found


def plain_png(data: bytes) -> bytes:
    """Remove text and profile, because Pillow refuses those beyond 1 MiB. Raises ValueError if they are damaged."""
    kept, at = [], 0
    for kind, start, end in _chunks(data):
        if kind in PNG_ANCILLARY:
            if zlib.crc32(data[start - 4 : end]) != _number(data, end, 4):
                raise ValueError(f"bad checksum of {kind.decode()}")
            kept.append(data[at : start - 8])
            at = end + 4
    return b"".join([*kept, data[at:]]) if at else data


def _chunks(data: bytes) -> Iterator[Span]:
    at = len(PNG_MAGIC)
    while at + 8 <= len(data):
        end = at + 8 + _number(data, at, 4)
        yield data[at + 4 : at + 8], at + 8, end
        at = end + 4


def bmp_profile(data: bytes) -> bytes | None:
    """Return the ICC profile embedded in a BMP file, if any."""
    if int.from_bytes(data[14:18], "little") != BMP_V5 or data[70:74] != BMP_EMBEDDED:
        return None
    start, length = struct.unpack_from("<II", data, 126)
    return data[14 + start : 14 + start + length]


def brands(data: bytes) -> list[bytes]:
    """Brands of an AVIF or HEIC file, the major one first; empty for other files."""
    if data[4:8] != b"ftyp":
        return []
    end = min(int.from_bytes(data[:4], "big"), len(data), 256)
    return [data[8:12], *(data[at : at + 4] for at in range(16, end - 3, 4))]


def exif_orientation(block: object) -> int:
    """Orientation stated by an EXIF block, 1 to 8; 1 if there is none.

    Only this entry is parsed: Pillow parses all, and warns of damage that does not matter here.
    """
    tiff = re.sub(EXIF_MARKS, b"", block) if isinstance(block, bytes) else b""
    order = "<" if tiff[:2] == b"II" else ">"
    try:
        (at,) = struct.unpack_from(order + "I", tiff, 4)
        (entries,) = struct.unpack_from(order + "H", tiff, at)
        for place in range(at + 2, at + 2 + 12 * entries, 12):
            tag, _, _, value = struct.unpack_from(order + "HHIH", tiff, place)
            if tag == ORIENTATION:
                return value if value in range(1, 9) else 1
    except struct.error:  # damaged EXIF data says nothing about the pixels
        pass
    return 1


def jpeg_xl_header(data: bytes) -> JpegXl:
    """Parse the header of a JPEG XL file (ISO/IEC 18181-1, annex D). Raises ValueError."""
    if data.startswith(JPEG_XL_MAGICS[1]):  # boxes: jxlp is a part with its number in front, jxlc the whole codestream
        starts = {b"jxlp": 4, b"jxlc": 0}
        parts = (data[at + starts[kind] : end] for kind, at, end in boxes(data) if kind in starts)
        data = b"".join(part[:64] for part in parts)
    bits = _Bits(data[2:64])
    height, width = bits.size()
    orientation, is_animated, depth = 1, False, 8
    if not bits.take(1):
        if bits.take(1):
            orientation = 1 + bits.take(3)
            if bits.take(1):
                bits.size()
            if bits.take(1):
                raise ValueError("it has a preview")
            is_animated = bool(bits.take(1))
        if not is_animated:  # else the animation's header is next
            depth = 32 if bits.take(1) else bits.choice(DEPTHS)
    return JpegXl(*((height, width) if orientation >= 5 else (width, height)), is_animated, depth)


class _Bits:
    """Reader of a JPEG XL header's fields, lowest bit first."""

    def __init__(self, data: bytes) -> None:
        self.value, self.count = int.from_bytes(data, "little"), 8 * len(data)

    def take(self, count: int) -> int:
        if count > self.count:
            raise ValueError("its header is truncated")
        taken = self.value & ((1 << count) - 1)
        self.value >>= count
        self.count -= count
        return taken

    def choice(self, of: tuple[tuple[int, int], ...]) -> int:
        count, minimum = of[self.take(2)]
        return minimum + self.take(count)

    def size(self) -> tuple[int, int]:
        """Read height and width."""
        is_small = self.take(1)
        height, ratio = self._side(is_small), self.take(3)
        if ratio == 0:
            return height, self._side(is_small)
        over, under = RATIOS[ratio - 1]
        return height, height * over // under

    def _side(self, is_small: int) -> int:
        return 8 * (1 + self.take(5)) if is_small else self.choice(SIDES)


def _number(data: bytes, at: int, length: int) -> int:
    return int.from_bytes(data[at : at + length], "big")


def boxes(data: bytes) -> Iterator[Span]:
    """Yield the outermost boxes, up to the first that does not fit, and at most MAX_BOXES."""
    start = 0
    for _ in range(MAX_BOXES):
        length, kind, body = _number(data, start, 4), data[start + 4 : start + 8], start + 8
        if length == 1:
            length, body = _number(data, start + 8, 8), start + 16
        elif length == 0:
            length = len(data) - start
        if start + length > len(data) or start + length < body:
            return
        yield kind, body, start + length
        start += length
