"""Parsers for parts of image files that Pillow does not expose, or misreads.

PNG's chunks, the boxes of AVIF and HEIC, the header of JPEG XL, JPEG's markers, the headers of BMP and TIFF.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import NamedTuple

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
PNG_ANCILLARY = (b"tEXt", b"zTXt", b"iTXt", b"iCCP")

JPEG_END = b"\xff\xd9"
JPEG_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # ITU-T T.81, table B.1
JPEG_SCAN = 0xDA
JPEG_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd8\xff]", re.DOTALL)  # only markers that begin a segment

BMP_V5, BMP_EMBEDDED = 124, b"DEBM"  # size of the header; colour space PROFILE_EMBEDDED

TIFF_BIG = 43
NEW_SUBFILE_TYPE, SUBFILE_TYPE = 254, 255  # the two lowest tags; entries are sorted, so they come first
PREVIEW_OR_MASK, OLD_PREVIEW = 1 | 4, 2
MAX_PAGES = 100

Span = tuple[bytes, int, int]  # kind, start and end of the content

JPEG_XL_MAGICS = (b"\xff\x0a", b"\0\0\0\x0cJXL \r\n\x87\n")  # bare codestream; codestream in boxes
# ISO/IEC 18181-1: two bits choose a pair: the width in bits of the number that follows, and the offset added to it.
SIDES = ((9, 1), (13, 1), (18, 1), (30, 1))
PREVIEW_SIDES = ((6, 1), (8, 65), (10, 321), (12, 1345))
PREVIEW_EIGHTHS = ((0, 16), (0, 32), (5, 1), (9, 33))
DEPTHS = ((0, 8), (0, 10), (0, 12), (6, 1))
RATIOS = ((1, 1), (12, 10), (4, 3), (3, 2), (16, 9), (5, 4), (2, 1))


class JpegXl(NamedTuple):
    """The header of a JPEG XL: size in pixels as displayed, whether it is animated, bits per sample."""

    width: int
    height: int
    is_animated: bool
    depth: int


def of_png(data: bytes) -> dict[bytes, bytes]:
    """Find the chunks cICP, iCCP, tRNS and eXIf. Pillow finds an eXIf after the pixels only after decoding them."""
    found: dict[bytes, bytes] = {}
    for kind, start, end in _png_chunks(data):
        if kind in (b"cICP", b"iCCP", b"tRNS", b"eXIf"):
            found.setdefault(kind, data[start:end])
    return found


def plain_png(data: bytes) -> bytes:
    """Remove text and profile, because Pillow refuses those beyond 1 MiB. Raises ValueError if they are damaged."""
    kept, at = [], 0
    for kind, start, end in _png_chunks(data):
        if kind in PNG_ANCILLARY:
            if zlib.crc32(data[start - 4 : end]) != _number(data, end, 4):
                raise ValueError(f"bad checksum of {kind.decode()}")
            kept.append(data[at : start - 8])
            at = end + 4
    return b"".join([*kept, data[at:]]) if at else data


def _png_chunks(data: bytes) -> Iterator[Span]:
    at = len(PNG_MAGIC)
    while at + 8 <= len(data):
        end = at + 8 + _number(data, at, 4)
        yield data[at + 4 : at + 8], at + 8, end
        at = end + 4


def lacks_end(jpeg: bytes) -> bool:
    """Whether a JPEG has all its scans but no end marker. The last scan may be truncated."""
    at, left = 2, None
    if jpeg.endswith(JPEG_END):
        return False
    try:
        while found := JPEG_MARKER.search(jpeg, at):
            kind, at = found.group()[1], found.end()
            if kind == JPEG_END[1]:
                return False
            segment = jpeg[at + 2 : at + _number(jpeg, at, 2)]
            if kind in JPEG_FRAMES:
                left = {segment[6 + 3 * n]: set(range(64)) for n in range(segment[5])}
            elif kind == JPEG_SCAN and left is not None:
                first, last, bits = segment[1 + 2 * segment[0] :][:3]
                for n in range(segment[0] if bits & 15 == 0 else 0):  # else later scans refine these coefficients
                    left[segment[1 + 2 * n]] -= set(range(first, last + 1))
            at += _number(jpeg, at, 2)
    except (IndexError, KeyError, ValueError):
        return False
    return left is not None and not any(left.values())


def profile_of_bmp(data: bytes) -> bytes | None:
    """Return the ICC profile embedded in the file, if any."""
    if int.from_bytes(data[14:18], "little") != BMP_V5 or data[70:74] != BMP_EMBEDDED:
        return None
    start, length = struct.unpack_from("<II", data, 126)
    return data[14 + start : 14 + start + length]


def holds_one_picture(tiff: bytes) -> bool:
    """Whether all pages after the first are previews and masks."""
    order = "<" if tiff[:2] == b"II" else ">"
    big = struct.unpack_from(order + "H", tiff, 2)[0] == TIFF_BIG
    count, entry, link, first = ("Q", "HHQQ", "Q", 8) if big else ("H", "HHII", "I", 4)
    (at,) = struct.unpack_from(order + link, tiff, first)
    seen: set[int] = set()
    try:
        while at and at not in seen and len(seen) < MAX_PAGES:
            (entries,) = struct.unpack_from(order + count, tiff, at)
            at_first, size = at + struct.calcsize(count), struct.calcsize("=" + entry)
            places = [at_first + n * size for n in range(min(entries, 2))]
            if seen and not _is_preview_or_mask(tiff, order + entry, places):
                return False
            seen.add(at)
            (at,) = struct.unpack_from(order + link, tiff, at_first + entries * size)
    except (struct.error, OverflowError):  # the chain of pages is damaged after the first
        return True
    return len(seen) < MAX_PAGES


def _is_preview_or_mask(tiff: bytes, entry: str, places: list[int]) -> bool:
    for place in places:
        tag, kind, _, value = struct.unpack_from(entry, tiff, place)
        if kind == 3:  # a 16-bit value, stored in the first bytes of the field
            (value,) = struct.unpack_from(entry[0] + "H", tiff, place + struct.calcsize(entry[:-1]))
        if (tag == NEW_SUBFILE_TYPE and value & PREVIEW_OR_MASK) or (tag == SUBFILE_TYPE and value == OLD_PREVIEW):
            return True
    return False


def brands(data: bytes) -> list[bytes]:
    """Brands of an AVIF or HEIC file, the major one first; empty for other files."""
    if data[4:8] != b"ftyp":
        return []
    end = min(int.from_bytes(data[:4], "big"), len(data), 256)
    return [data[8:12], *(data[at : at + 4] for at in range(16, end - 3, 4))]


def code_points(data: bytes) -> tuple[int, int] | None:
    """Primaries and transfer (H.273) of an AVIF or HEIC file's primary picture, if stated."""
    for kind, at, _ in _properties(data):
        if kind == b"colr" and data[at : at + 4] == b"nclx":
            return _number(data, at + 4, 2), _number(data, at + 6, 2)
    return None


def clean_aperture(data: bytes, width: int, height: int) -> tuple[int, int, int, int] | None:
    """Visible part (x0, y0, x1, y1) of an AVIF file's primary picture; None if not stated, or invalid.

    ISO/IEC 14496-12, 12.1.4: width, height, and the offset of the part's centre from the picture's, all as fractions.
    """
    for kind, at, end in _properties(data):
        if kind == b"clap" and end - at == 32:
            numbers = struct.unpack_from(">iIiIiIiI", data, at)
            if not all(numbers[1::2]):
                return None
            w, h, across, down = (Fraction(over, under) for over, under in zip(*[iter(numbers)] * 2, strict=True))
            x, y = int((width - w) / 2 + across), int((height - h) / 2 + down)
            right, bottom = x + int(w), y + int(h)
            return (x, y, right, bottom) if 0 <= x < right <= width and 0 <= y < bottom <= height else None
    return None


def _properties(data: bytes) -> Iterator[Span]:
    """Yield the properties of the primary picture of an AVIF or HEIC file.

    ISO/IEC 23008-12: box meta contains pitm (the number of the primary picture) and iprp, which contains ipco (a list
    of properties) and ipma (which pictures have which properties).
    """
    meta = _box(data, b"meta", 0, len(data))
    if meta is None:
        return
    start, end = meta[0] + 4, meta[1]
    first, iprp = _box(data, b"pitm", start, end), _box(data, b"iprp", start, end)
    if first is None or iprp is None:
        return
    primary = _number(data, first[0] + 4, 4 if data[first[0] : first[0] + 1] > b"\0" else 2)
    ipco, ipma = _box(data, b"ipco", *iprp), _box(data, b"ipma", *iprp)
    if ipco is None or ipma is None:
        return
    properties = list(_boxes(data, *ipco))
    for index in _associated(data[ipma[0] : ipma[1]], primary):
        if 0 < index <= len(properties):
            yield properties[index - 1]


def of_jpeg_xl(data: bytes) -> JpegXl:
    """Parse the header of a JPEG XL file (ISO/IEC 18181-1, annex D). Raises ValueError."""
    if data.startswith(JPEG_XL_MAGICS[1]):  # boxes: jxlp is a part with its number in front, jxlc the whole codestream
        starts = {b"jxlp": 4, b"jxlc": 0}
        parts = (data[at + starts[kind] : end] for kind, at, end in _boxes(data, 0, len(data)) if kind in starts)
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
                bits.preview()
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
        count, least = of[self.take(2)]
        return least + self.take(count)

    def size(self) -> tuple[int, int]:
        """Read height and width."""
        return self._two(lambda: 8 * (1 + self.take(5))) if self.take(1) else self._two(lambda: self.choice(SIDES))

    def preview(self) -> tuple[int, int]:
        if self.take(1):
            return self._two(lambda: 8 * self.choice(PREVIEW_EIGHTHS))
        return self._two(lambda: self.choice(PREVIEW_SIDES))

    def _two(self, side: Callable[[], int]) -> tuple[int, int]:
        height, ratio = side(), self.take(3)
        if ratio == 0:
            return height, side()
        over, under = RATIOS[ratio - 1]
        return height, height * over // under


def _number(data: bytes, at: int, length: int) -> int:
    return int.from_bytes(data[at : at + length], "big")


def _boxes(data: bytes, start: int, end: int) -> Iterator[Span]:
    """Yield the boxes in a span, up to the first that does not fit."""
    while start + 8 <= end:
        length, kind, body = _number(data, start, 4), data[start + 4 : start + 8], start + 8
        if length == 1:
            length, body = _number(data, start + 8, 8), start + 16
        elif length == 0:
            length = end - start
        if start + length > end or start + length < body:
            return
        yield kind, body, start + length
        start += length


def _box(data: bytes, kind: bytes, start: int, end: int) -> tuple[int, int] | None:
    return next(((body, last) for found, body, last in _boxes(data, start, end) if found == kind), None)


def _associated(ipma: bytes, primary: int) -> Iterator[int]:
    """Yield the numbers, from 1 on, of a picture's properties."""
    id_length, wide = (4 if ipma[:1] > b"\0" else 2), bool(ipma[3:4] > b"\0" and ipma[3] & 1)
    at, length = 8, 2 if wide else 1
    for _ in range(_number(ipma, 4, 4)):
        if at + id_length >= len(ipma):
            return
        item, count = _number(ipma, at, id_length), ipma[at + id_length]
        at += id_length + 1
        if item == primary:
            for place in range(at, at + count * length, length):
                yield _number(ipma, place, length) & (0x7FFF if wide else 0x7F)
        at += count * length
