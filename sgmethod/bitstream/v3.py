"""The .sg file, version 3 (profile rd): a short header, then one entropy-coded payload.

The payload's model is native (sgmethod/native/rd_models.h), written once for both directions; docs/format.md
describes it.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sgmethod.bitstream.v1 import MAGIC, MAX_SIDE, PREFIX_BYTES
from sgmethod.errors import BitstreamError
from sgmethod.native import native
from sgmethod.scene import Gaussians

VERSION = 3
HEADER = struct.Struct(">BHHH3B")  # flags, width, height, quantum code, background
HEADER_BYTES = PREFIX_BYTES + HEADER.size
FLAG_GREY, FLAG_UPRIGHT = 1, 2
CUTOFF = 3.0  # sigma at which a Gaussian of this version ends
MIN_QUANTUM, MAX_QUANTUM = 2.0**-10, 16.0


def quantum_code(quantum: float) -> int:
    """The 16-bit code of the nearest quantum: (1 + f / 256) 2^(4 - e), e in the high byte, f in the low."""
    quantum = min(max(quantum, MIN_QUANTUM), MAX_QUANTUM)
    exponent = math.floor(math.log2(quantum))
    fraction = round((quantum / 2.0**exponent - 1) * 256)
    if fraction == 256:
        exponent, fraction = exponent + 1, 0
    return (4 - exponent) << 8 | fraction


def quantum_of(code: int) -> float:
    """The quantum of a 16-bit code; exact in float64."""
    return (1 + (code & 0xFF) / 256) * 2.0 ** (4 - (code >> 8))


@dataclass(frozen=True)
class RdStream:
    """A version 3 file.

    quantum: root of the picture energy (image in [0, 1], summed over pixels and channels) that one quantiser step
    of any parameter stands for; background: 8-bit RGB below all Gaussians; grey: no chroma in the payload;
    upright: no shear in it.
    """

    width: int
    height: int
    quantum: float
    background: tuple[int, int, int]
    grey: bool
    upright: bool
    payload: bytes

    @classmethod
    def of(
        cls, gaussians: Gaussians, size: tuple[int, int], quantum: float, background: tuple[int, int, int], grey: bool
    ) -> RdStream:
        """Quantise and code Gaussians over a picture of size (width, height)."""
        quantum = quantum_of(quantum_code(quantum))
        upright = not gaussians.factors[:, 1].any()
        parameters = native.RdParameters(*size, quantum, grey, upright)
        payload = native.rd_encode(parameters, gaussians.means, gaussians.factors, gaussians.colors)
        return cls(*size, quantum, background, grey, upright, payload)

    def gaussians(self, prefix: float = 1.0, max_gaussians: int | None = None) -> Gaussians:
        """The Gaussians, largest first; with prefix < 1 those in that part of the payload.

        Raises BitstreamError, also for more than max_gaussians.
        """
        limit = {} if max_gaussians is None else {"max_gaussians": max_gaussians}
        parameters = native.RdParameters(self.width, self.height, self.quantum, self.grey, self.upright)
        cut = math.ceil(prefix * len(self.payload))
        try:
            return Gaussians(*native.rd_decode(parameters, self.payload[:cut], prefix < 1, **limit))
        except RuntimeError as error:
            raise BitstreamError(f"the file is damaged: {error}") from error
        except OverflowError as error:
            raise BitstreamError(f"the file has more Gaussians than the limit of {max_gaussians}") from error

    def size_bits(self) -> dict[str, int]:
        """Bits spent on the header and on the payload, which mixes all attributes."""
        return {"headers": 8 * HEADER_BYTES, "payload": 8 * len(self.payload)}


def serialise(stream: RdStream) -> bytes:
    """The file's bytes."""
    flags = FLAG_GREY * stream.grey | FLAG_UPRIGHT * stream.upright
    code = quantum_code(stream.quantum)
    body = HEADER.pack(flags, stream.width, stream.height, code, *stream.background) + stream.payload
    return MAGIC + bytes([VERSION]) + struct.pack(">I", zlib.crc32(body)) + body


def parse(data: bytes, max_pixels: int | None = None) -> RdStream:
    """The header and payload of a version 3 file. Raises BitstreamError for anything but a whole, intact file."""
    if len(data) < HEADER_BYTES:
        raise BitstreamError(f"the file is too short: {len(data)} bytes")
    body = memoryview(data)[PREFIX_BYTES:]
    if zlib.crc32(body) != struct.unpack(">I", data[4:8])[0]:
        raise BitstreamError("the file is damaged: its checksum does not match")
    flags, width, height, code, *background = HEADER.unpack(body[: HEADER.size])
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise BitstreamError(f"the picture's size is {width} x {height}")
    if flags > (FLAG_GREY | FLAG_UPRIGHT):
        raise BitstreamError(f"header field flags is {flags}, which this version does not know")
    quantum = quantum_of(code)
    if not MIN_QUANTUM <= quantum <= MAX_QUANTUM:
        raise BitstreamError(f"header field quantum is {quantum}, outside {MIN_QUANTUM} .. {MAX_QUANTUM}")
    if max_pixels is not None and width * height > max_pixels:
        raise BitstreamError(f"{width} x {height} pixels are more than the limit of {max_pixels}")
    red, green, blue = background
    payload = bytes(body[HEADER.size :])
    return RdStream(
        width, height, quantum, (red, green, blue), bool(flags & FLAG_GREY), bool(flags & FLAG_UPRIGHT), payload
    )


def background_of(pixels: NDArray[np.float32]) -> tuple[int, int, int]:
    """The mean colour of an image [H, W, 3] in [0, 1], to 8 bits."""
    red, green, blue = (round(255 * float(v)) for v in pixels.reshape(-1, 3).mean(0, dtype=np.float64))
    return red, green, blue
