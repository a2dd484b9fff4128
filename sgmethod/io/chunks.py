"""What Pillow does not tell of a file, read from its own structure: PNG's chunks, the boxes of AVIF and HEIC,
the header of JPEG XL."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"

Span = tuple[bytes, int, int]  # kind, where its content begins and ends

JPEG_XL_MAGICS = (b"\xff\x0a", b"\0\0\0\x0cJXL \r\n\x87\n")  # of a bare codestream, and of one in boxes
# ISO/IEC 18181-1: what a number of so many bits is added to; by two bits before it.
SIDES = ((9, 1), (13, 1), (18, 1), (30, 1))
PREVIEW_SIDES = ((6, 1), (8, 65), (10, 321), (12, 1345))
PREVIEW_EIGHTHS = ((0, 16), (0, 32), (5, 1), (9, 33))
DEPTHS = ((0, 8), (0, 10), (0, 12), (6, 1))
RATIOS = ((1, 1), (12, 10), (4, 3), (3, 2), (16, 9), (5, 4), (2, 1))


class JpegXl(NamedTuple):
    """What the header of a JPEG XL says: pixels as the picture is to be seen, whether it moves, bits of a sample."""

    width: int
    height: int
    moves: bool
    depth: int


def of_png(data: bytes) -> dict[bytes, bytes]:
    """cICP and eXIf, which may stand behind the pixels, where Pillow finds it only by decoding them."""
    found: dict[bytes, bytes] = {}
    at = len(PNG_MAGIC)
    while at + 8 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        kind = data[at + 4 : at + 8]
        if kind in (b"cICP", b"eXIf"):
            found.setdefault(kind, data[at + 8 : at + 8 + length])
        at += length + 12
    return found


def brands(data: bytes) -> list[bytes]:
    """Of an AVIF or HEIC file, the major one first; none for other files."""
    if data[4:8] != b"ftyp":
        return []
    end = min(int.from_bytes(data[:4], "big"), len(data), 256)
    return [data[8:12], *(data[at : at + 4] for at in range(16, end - 3, 4))]


def code_points(data: bytes) -> tuple[int, int] | None:
    """Primaries and transfer (H.273) of an AVIF or HEIC file's primary picture; None where it states none.

    ISO/IEC 23008-12: meta holds pitm, the number of the primary picture, and iprp, which holds ipco, the properties,
    and ipma, which pictures have which.
    """
    meta = _box(data, b"meta", 0, len(data))
    if meta is None:
        return None
    start, end = meta[0] + 4, meta[1]
    first, iprp = _box(data, b"pitm", start, end), _box(data, b"iprp", start, end)
    if first is None or iprp is None:
        return None
    primary = _number(data, first[0] + 4, 4 if data[first[0] : first[0] + 1] > b"\0" else 2)
    ipco, ipma = _box(data, b"ipco", *iprp), _box(data, b"ipma", *iprp)
    if ipco is None or ipma is None:
        return None
    properties = list(_boxes(data, *ipco))
    for index in _associated(data[ipma[0] : ipma[1]], primary):
        kind, at, _ = properties[index - 1] if 0 < index <= len(properties) else (b"", 0, 0)
        if kind == b"colr" and data[at : at + 4] == b"nclx":
            return _number(data, at + 4, 2), _number(data, at + 6, 2)
    return None


def of_jpeg_xl(data: bytes) -> JpegXl:
    """The header of a JPEG XL file, without decoding it (ISO/IEC 18181-1, annex D). Raises ValueError."""
    if data.startswith(JPEG_XL_MAGICS[1]):  # in parts, each with its number first, or whole
        starts = {b"jxlp": 4, b"jxlc": 0}
        parts = (data[at + starts[kind] : end] for kind, at, end in _boxes(data, 0, len(data)) if kind in starts)
        data = b"".join(part[:64] for part in parts)
    bits = _Bits(data[2:64])
    height, width = bits.size()
    orientation, moves, depth = 1, False, 8
    if not bits.take(1):
        if bits.take(1):
            orientation = 1 + bits.take(3)
            if bits.take(1):
                bits.size()
            if bits.take(1):
                bits.preview()
            moves = bool(bits.take(1))
        if not moves:  # else how it moves stands here
            depth = 32 if bits.take(1) else bits.choice(DEPTHS)
    return JpegXl(height, width, moves, depth) if orientation >= 5 else JpegXl(width, height, moves, depth)


class _Bits:
    """The fields of a JPEG XL header, the lowest bit first."""

    def __init__(self, data: bytes) -> None:
        self.value, self.count = int.from_bytes(data, "little"), 8 * len(data)

    def take(self, count: int) -> int:
        if count > self.count:
            raise ValueError("its header is cut short")
        taken = self.value & ((1 << count) - 1)
        self.value >>= count
        self.count -= count
        return taken

    def choice(self, of: tuple[tuple[int, int], ...]) -> int:
        count, least = of[self.take(2)]
        return least + self.take(count)

    def size(self) -> tuple[int, int]:
        """Height and width."""
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
    """The boxes of a span, as far as they lie within it."""
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
    """The numbers of the properties of a picture, from 1 on."""
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
