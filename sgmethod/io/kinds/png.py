"""PNG. Written files are tagged as sRGB; every row has the filter Up, and the caller may supply another deflate.

768x512 decoded from 15 kB (kodim23; kodim04), one core of an EPYC:

    zlib, level 5         36 ms   388 kB;   35 ms   438 kB
    zlib, level 6         76 ms   377 kB;   67 ms   428 kB
    isal, level 1          3 ms   427 kB;    4 ms   480 kB
    Pillow, level 4       45 ms   391 kB;   52 ms   433 kB   a filter for each row

For kodim23-crop enlarged to that size, zlib needs 377 kB and 24 ms at level 4, 365 kB and 42 ms at level 5. Two threads
take 60 % of the time of one.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sgmethod.io.chunks import Span, number
from sgmethod.io.kinds.format import Compress, Format, Writer
from sgmethod.threads import in_parallel

MAGIC = b"\x89PNG\r\n\x1a\n"
ANCILLARY = (b"tEXt", b"zTXt", b"iTXt", b"iCCP")
FILTER_UP = 2  # PNG specification, 9.2: each byte minus the one above it
SRGB = b"\0"  # 11.3.2.5: perceptual intent
COLOUR_TYPES = {3: 2, 4: 6}  # 11.2.2, by number of channels: RGB, RGBA
MAX_CHUNK_BYTES = 1 << 24
ZLIB_LEVEL = 4
ZLIB_HEADER = b"\x78\x5e"  # RFC 1950, 2.2: deflate, a window of 32 KiB, a fast level
WITHOUT_HEADER = -15
WINDOW_BYTES = 1 << 15


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
        if kind in ANCILLARY:
            if zlib.crc32(data[start - 4 : end]) != number(data, end, 4):
                raise ValueError(f"bad checksum of {kind.decode()}")
            kept.append(data[at : start - 8])
            at = end + 4
    return b"".join([*kept, data[at:]]) if at else data


def _chunks(data: bytes) -> Iterator[Span]:
    at = len(MAGIC)
    while at + 8 <= len(data):
        end = at + 8 + number(data, at, 4)
        yield data[at + 4 : at + 8], at + 8, end
        at = end + 4


def zlib_compress(data: memoryview) -> bytes:
    """Deflate with zlib, on two threads if allowed: the halves form one stream (RFC 1950, 1951)."""
    rows = data.cast("B")
    middle = len(rows) // 2

    def deflate(half: int) -> bytes:
        if half == 0:
            compressor = zlib.compressobj(ZLIB_LEVEL, wbits=WITHOUT_HEADER)
            return compressor.compress(rows[:middle]) + compressor.flush(zlib.Z_SYNC_FLUSH)
        before = rows[max(0, middle - WINDOW_BYTES) : middle]  # the second half may refer back to it
        compressor = zlib.compressobj(ZLIB_LEVEL, wbits=WITHOUT_HEADER, zdict=before)
        return compressor.compress(rows[middle:]) + compressor.flush()

    return ZLIB_HEADER + b"".join(in_parallel(deflate, range(2))) + struct.pack(">I", zlib.adler32(rows))


def encode_png(pixels: NDArray[np.uint8], compress: Compress = zlib_compress) -> bytes:
    """Encode pixels, uint8 [H, W, 3], or [H, W, 4] with alpha, as an 8-bit PNG file.

    compress: makes a zlib stream (RFC 1950) of the filtered rows, uint8 [H, 1 + 3 W] or [H, 1 + 4 W].
    Raises ValueError on another shape or type.
    """
    if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] not in COLOUR_TYPES or pixels.size == 0:
        raise ValueError(f"pixels must be uint8 [H, W, 3 or 4], got {pixels.dtype} {list(pixels.shape)}")
    height, width, channels = pixels.shape
    data = compress(_filtered(pixels.reshape(height, width * channels)).data)
    parts = [data[start : start + MAX_CHUNK_BYTES] for start in range(0, len(data), MAX_CHUNK_BYTES)]
    header = struct.pack(">IIBBBBB", width, height, 8, COLOUR_TYPES[channels], 0, 0, 0)
    chunks = [
        _chunk(b"IHDR", header),
        _chunk(b"sRGB", SRGB),
        *(_chunk(b"IDAT", part) for part in parts),
        _chunk(b"IEND", b""),
    ]
    return b"".join((MAGIC, *chunks))


def _filtered(flat: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Filter rows [H, N]: [H, 1 + N]. They are as large as the picture, and should go once they are compressed."""
    height, values = flat.shape
    rows = np.empty((height, 1 + values), np.uint8)
    rows[:, 0] = FILTER_UP
    rows[0, 1:] = flat[0]
    np.subtract(flat[1:], flat[:-1], out=rows[1:, 1:])
    return rows


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))


FORMAT = Format(
    "PNG",
    (".png", ".apng"),
    ("PIL.PngImagePlugin", "PngImageFile"),
    re.escape(MAGIC),
    prepared=plain_png,
    writer=Writer((".png",), write=encode_png, media_type="image/png"),
)
