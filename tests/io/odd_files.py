"""Sound files that few programs write, byte by byte by their specifications."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Mapping, Sequence

import numpy as np
import pillow_heif
from PIL import Image

from tests.support.attacks import png_chunk as chunk

Tags = Mapping[int, "int | tuple[int, ...]"]
SHORT, LONG = 3, 4  # TIFF 6.0, section 2


def png(
    rows: bytes,
    size: tuple[int, int],
    before: Sequence[bytes] = (),
    after: Sequence[bytes] = (),
    *,
    depth: int = 8,
    colour: int = 2,
) -> bytes:
    """A PNG of unfiltered rows, in RGB unless the type of colour is another; whole chunks before and after them."""
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", *size, depth, colour, 0, 0, 0))
    return b"".join(
        (b"\x89PNG\r\n\x1a\n", header, *before, chunk(b"IDAT", zlib.compress(rows)), *after, chunk(b"IEND"))
    )


def tiff(pages: Sequence[tuple[np.ndarray, Tags]], order: str = "<", *, big: bool = False) -> bytes:
    """A TIFF, or a BigTIFF, of uncompressed pages [H, W, C], each one strip, with further tags or other values."""
    count, offset = ("Q", "Q") if big else ("H", "I")
    number = struct.pack(order + "HHH", 43, 8, 0) if big else struct.pack(order + "H", 42)
    mark = {"<": b"II", ">": b"MM"}[order] + number
    file, link = bytearray(mark + struct.pack(order + offset, 0)), len(mark)
    for samples, more in pages:
        height, width, channels = samples.shape
        body = samples.astype(samples.dtype.newbyteorder(order)).tobytes()
        bits = (8 * samples.dtype.itemsize,) * channels
        tags: dict[int, int | tuple[int, ...]] = {256: width, 257: height, 258: bits}
        tags |= {259: 1, 262: 1 if channels < 3 else 2, 273: len(file), 277: channels, 278: height, 279: len(body)}
        tags |= more
        file += body
        entries = b""
        for tag, value in sorted(tags.items()):
            values = value if isinstance(value, tuple) else (value,)
            kind, code = (LONG, "I") if tag in (254, 273, 279) or max(values) > 0xFFFF else (SHORT, "H")
            packed = struct.pack(f"{order}{len(values)}{code}", *values)
            if len(packed) > struct.calcsize(offset):
                packed, at = struct.pack(order + offset, len(file)), packed
                file += at
            entries += struct.pack(f"{order}HH{offset}", tag, kind, len(values))
            entries += packed.ljust(struct.calcsize(offset), b"\0")
        file[link : link + struct.calcsize(offset)] = struct.pack(order + offset, len(file))
        file += struct.pack(order + count, len(tags)) + entries
        link = len(file)
        file += bytes(struct.calcsize(offset))
    return bytes(file)


def bmp(
    pixels: np.ndarray, *, header: int = 124, space: bytes = b"sRGB", more: bytes = bytes(60), behind: bytes = b""
) -> bytes:
    """A 24-bit BMP of version 4 or 5, whose colours are in `space` (little-endian) with `more` of its header behind."""
    height, width, _ = pixels.shape
    body = pixels[::-1, :, ::-1].tobytes()
    info = struct.pack("<IiiHHIIiiII", header, width, height, 1, 24, 0, len(body), 0, 0, 0, 0) + bytes(16) + space[::-1]
    info = (info + more).ljust(header, b"\0")[:header]
    return b"BM" + struct.pack("<IHHI", 14 + header + len(body) + len(behind), 0, 0, 14 + header) + info + body + behind


def gif(screen: tuple[int, int], frames: Sequence[tuple[int, int, int, int, int]], hole: int | None = None) -> bytes:
    """A GIF of frames (x, y, width, height, colour), each of one of four colours. hole: the one that is transparent."""
    palette = bytes((255, 0, 0, 0, 255, 0, 0, 0, 255, 10, 20, 30))
    file = b"GIF89a" + struct.pack("<HHBBB", *screen, 0x81, 2, 0) + palette
    for x, y, width, height, colour in frames:
        bits = length = 0
        for symbol in [4, colour] * (width * height) + [5]:  # a clear code before each, so that codes stay 3 bits wide
            bits |= symbol << length
            length += 3
        packed = bits.to_bytes(-(-length // 8), "little")
        parts = (packed[start : start + 255] for start in range(0, len(packed), 255))
        if hole is not None:
            file += b"!\xf9\4\1\0\0" + bytes([hole, 0])
        file += b"," + struct.pack("<HHHHB", x, y, width, height, 0) + b"\2"
        file += b"".join(bytes([len(part)]) + part for part in parts) + b"\0"
    return file + b";"


def heif(
    pixels: np.ndarray, kind: str, properties: Sequence[bytes] = (), others: Sequence[bytes] = (), **options: object
) -> bytes:
    """An AVIF or HEIC with further properties, whole boxes: of its picture, and of none, which come before all."""
    saved = io.BytesIO()
    if kind == "AVIF":
        Image.fromarray(pixels).save(saved, kind, quality=100, subsampling="4:4:4", **options)
    else:
        pillow_heif.from_pillow(Image.fromarray(pixels)).save(saved, format="HEIF", quality=100, chroma=444, **options)
    data = bytearray(saved.getvalue())
    for box in properties:
        _add_property(data, box)
    for box in others:
        _add_other(data, box)
    return bytes(data)


def _length(data: bytearray, at: int) -> int:
    return int(struct.unpack_from(">I", data, at)[0])


def _grow(data: bytearray, name: bytes, by: int) -> int:
    """Make the first box of a kind longer; returns where it begins."""
    at = data.index(name) - 4
    struct.pack_into(">I", data, at, _length(data, at) + by)
    return at


def _add_property(data: bytearray, box: bytes) -> None:
    """ISO/IEC 14496-12 and 23008-12: ipco gets the box, ipma tells the first picture to have it, iloc follows."""
    moved = data.index(b"mdat") + 4
    ipco = _grow(data, b"ipco", len(box))
    end, here, count = ipco + _length(data, ipco) - len(box), ipco + 8, 1
    while here < end:
        here += _length(data, here)
        count += 1
    data[end:end] = box
    ipma = _grow(data, b"ipma", 1)
    number = data[ipma + 18]
    data[ipma + 18] = number + 1
    data.insert(ipma + 19 + number, 0x80 | count)
    _move_items(data, moved, len(box) + 1)


def _add_other(data: bytearray, box: bytes) -> None:
    """The first property of ipco, which no item has: all others are one place further."""
    moved = data.index(b"mdat") + 4
    ipco = _grow(data, b"ipco", len(box))
    data[ipco + 8 : ipco + 8] = box
    ipma = data.index(b"ipma") - 4
    at, end = ipma + 16, ipma + _length(data, ipma)
    while at < end:
        first = at + 3
        at = first + data[first - 1]
        data[first:at] = bytes(place + 1 for place in data[first:at])
    _move_items(data, moved, len(box))


def _move_items(data: bytearray, moved: int, by: int) -> None:
    """Everything from `moved` on lies `by` bytes further: the boxes around grow, and iloc follows."""
    for name in (b"iprp", b"meta"):
        _grow(data, name, by)
    at = data.index(b"iloc") + 4
    version, base, count = data[at], data[at + 5] >> 4, struct.unpack_from(">H", data, at + 6)[0]
    assert (version < 2, data[at + 4]) == (True, 0x44)
    at += 8
    for _ in range(count):
        at += 2 + 2 * version + 2
        if base and _length(data, at):
            struct.pack_into(">I", data, at, _length(data, at) + by)
        moves = not base or not _length(data, at)
        at += base
        extents = struct.unpack_from(">H", data, at)[0]
        at += 2
        for _ in range(extents):
            if moves and _length(data, at) >= moved:
                struct.pack_into(">I", data, at, _length(data, at) + by)
            at += 8


def nclx(primaries: int, transfer: int) -> bytes:
    """Colours as code points (H.273), ISO/IEC 14496-12, 12.1.5."""
    return struct.pack(">I4s4sHHHB", 19, b"colr", b"nclx", primaries, transfer, 6, 0x80)


def clap(width: int, height: int, x: int, y: int, full: tuple[int, int]) -> bytes:
    """A clean aperture, ISO/IEC 14496-12, 12.1.4: offsets are of its centre from the picture's, in halves."""
    across, down = 2 * x + width - full[0], 2 * y + height - full[1]
    return struct.pack(">I4s8i", 40, b"clap", width, 1, height, 1, across, 2, down, 2)


def turned(quarters: int) -> bytes:
    """A rotation against the clock."""
    return struct.pack(">I4sB", 9, b"irot", quarters)


def mirrored(axis: int) -> bytes:
    """ISO/IEC 23008-12:2022, 6.5.12: 0 puts the top at the bottom, 1 the left at the right."""
    return struct.pack(">I4sB", 9, b"imir", axis)
