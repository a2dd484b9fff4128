"""Files that cost much more than they look like."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from PIL import Image

from sgmethod.bitstream import container
from sgmethod.paper.stream import Group, PaperStream
from tests.support.pictures import SMALL, pixels_of, saved


def tiff_of_many_strips(strips: int) -> bytes:
    """A TIFF of 1 x 16,000 pixels that lists many strips of one byte."""
    after = 8 + 2 + 10 * 12 + 4
    tags = [
        *((256, 4, 1, 1), (257, 4, 1, 16_000), (258, 3, 1, 8), (259, 3, 1, 1), (262, 3, 1, 1)),
        *((273, 4, strips, after), (277, 3, 1, 1), (278, 4, 1, 1), (279, 4, strips, after + 4 * strips)),
        (284, 3, 1, 1),
    ]
    head = struct.pack("<2sHIH", b"II", 42, 8, len(tags)) + b"".join(struct.pack("<HHII", *tag) for tag in tags)
    return head + struct.pack("<I", 0) + struct.pack("<I", 8) * strips + struct.pack("<I", 1) * strips


def png_chunk(kind: bytes, data: bytes = b"") -> bytes:
    """A part of a PNG; a new one may stand after the first 33 bytes of any."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_that_claims(width: int, height: int, rows: bytes = b"") -> bytes:
    """A PNG of 8-bit grey with these filtered rows, however many it claims to have."""
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    parts = png_chunk(b"IHDR", header), png_chunk(b"IDAT", zlib.compress(rows, 9)), png_chunk(b"IEND")
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def png_of_many_chunks(chunks: int) -> bytes:
    return SMALL[:33] + png_chunk(b"abCd") * chunks + SMALL[33:]


def jpeg_of_many_markers(markers: int) -> bytes:
    jpeg = saved(Image.fromarray(pixels_of(SMALL)), "JPEG")
    return jpeg[:2] + (b"\xff\xe5\x00\x10" + bytes(14)) * markers + jpeg[2:]


def crowded_bitstream(gaussians: int = 400_000, side: int = 7000) -> bytes:
    """An .sg file of equal Gaussians that lie on each other, which take seconds to draw."""
    places, shapes = np.zeros((gaussians, 2), np.uint16), np.zeros((gaussians, 3), np.uint16)
    group = Group(1, places, shapes, np.zeros((gaussians, 2), np.uint8))
    middle, shape = np.full((2, 2), side / 2, np.float32), np.array([[30], [0], [30]], np.float32).repeat(2, 1)
    codebooks = np.full((2, 8, 3), 0.15, np.float16)
    return container.serialise(PaperStream("paper", side, side, 1, middle, shape, codebooks, (group,)))
