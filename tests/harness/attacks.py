"""Files that cost much more than they look like."""

from __future__ import annotations

import io
import struct
import zlib

import numpy as np
from PIL import Image

from sgmethod.bitstream import container
from sgmethod.bitstream.v3 import StreamV3
from sgmethod.scene import Gaussians
from tests.harness.pictures import SMALL


def tiff_of_many_strips(strips: int) -> bytes:
    """A TIFF of 1 x 16,000 pixels that lists so many strips of a byte each."""
    after = 8 + 2 + 10 * 12 + 4
    tags = [
        *((256, 4, 1, 1), (257, 4, 1, 16_000), (258, 3, 1, 8), (259, 3, 1, 1), (262, 3, 1, 1)),
        *((273, 4, strips, after), (277, 3, 1, 1), (278, 4, 1, 1), (279, 4, strips, after + 4 * strips)),
        (284, 3, 1, 1),
    ]
    head = struct.pack("<2sHIH", b"II", 42, 8, len(tags)) + b"".join(struct.pack("<HHII", *tag) for tag in tags)
    return head + struct.pack("<I", 0) + struct.pack("<I", 8) * strips + struct.pack("<I", 1) * strips


def png_of_many_chunks(chunks: int) -> bytes:
    """A small PNG with so many empty chunks."""
    chunk = struct.pack(">I4sI", 0, b"abCd", zlib.crc32(b"abCd"))
    return SMALL[:33] + chunk * chunks + SMALL[33:]


def jpeg_of_many_markers(markers: int) -> bytes:
    """A small JPEG with so many application markers."""
    file = io.BytesIO()
    Image.open(io.BytesIO(SMALL)).save(file, "JPEG")
    jpeg = file.getvalue()
    return jpeg[:2] + (b"\xff\xe5\x00\x10" + bytes(14)) * markers + jpeg[2:]


def crowded_bitstream(gaussians: int = 400_000, side: int = 7000) -> bytes:
    """An .sg file of equal Gaussians that lie on each other, which take seconds to draw."""
    shapes = np.tile(np.array([40, 0, 40], np.float32), (gaussians, 1))
    means = np.full((gaussians, 2), side / 2, np.float32)
    colors = np.full((gaussians, 3), 0.3, np.float32)
    scene = Gaussians(means, shapes, colors)
    return container.serialise(StreamV3.of(scene, (side, side), 0.5, (0, 0, 0), False))
