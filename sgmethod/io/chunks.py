"""Parsers of what several formats have: boxes and their brands (AVIF, HEIC, JPEG XL), the orientation in EXIF data."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator

EXIF_MARKS = re.compile(rb"^(Exif\0\0)*")  # some writers put it there twice
ORIENTATION = 274

MAX_BOXES = 1 << 16

Span = tuple[bytes, int, int]  # kind, start and end of the content
Box = tuple[int, int, int, int]  # x0, y0, x1, y1


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


def number(data: bytes, at: int, length: int) -> int:
    """Read an unsigned number, highest byte first."""
    return int.from_bytes(data[at : at + length], "big")


def boxes(data: bytes) -> Iterator[Span]:
    """Yield the outermost boxes, up to the first that does not fit, and at most MAX_BOXES."""
    start = 0
    for _ in range(MAX_BOXES):
        length, kind, body = number(data, start, 4), data[start + 4 : start + 8], start + 8
        if length == 1:
            length, body = number(data, start + 8, 8), start + 16
        elif length == 0:
            length = len(data) - start
        if start + length > len(data) or start + length < body:
            return
        yield kind, body, start + length
        start += length
