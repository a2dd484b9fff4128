"""What Pillow does not tell of a file, read from its own structure: PNG's chunks, the boxes of AVIF and HEIC."""

from __future__ import annotations

from collections.abc import Iterator

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"

Span = tuple[bytes, int, int]  # kind, where its content begins and ends


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
