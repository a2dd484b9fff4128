"""Bytes -> Gaussians -> 8-bit pixels. No torch here."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sgmethod import bitstream
from sgmethod.bitstream import Stream
from sgmethod.errors import BitstreamError
from sgmethod.gaussians import Gaussians
from sgmethod.native_module import native

MAX_PIXELS = 100_000_000  # 300 MB of output; a header can claim any size, memory cannot follow any


def dequantise(stream: Stream) -> Gaussians:
    """The Gaussians a stream describes, exactly as every decoder must see them (docs/format.md)."""
    if not stream.groups:
        return Gaussians(np.zeros((0, 2), np.float32), np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32))
    means = [_levels(g.positions, stream.position_range, stream.position_bits) for g in stream.groups]
    factors = [_levels(g.factors, stream.factor_range, g.bitwidth) for g in stream.groups]
    first, second = stream.codebooks.astype(np.float32)
    indices = np.concatenate([g.colors for g in stream.groups])
    colors = first[indices[:, 0]] + second[indices[:, 1]]
    return Gaussians(np.concatenate(means), np.concatenate(factors), colors)


def _levels(codes: NDArray[np.uint16], value_range: NDArray[np.float32], bits: int) -> NDArray[np.float32]:
    """low + code (high - low) / (2^bits - 1), computed in float64 and rounded once to float32."""
    low, high = value_range.astype(np.float64).T
    values: NDArray[np.float32] = (low + codes * ((high - low) / (2**bits - 1))).astype(np.float32)
    return values


def render_pixels(gaussians: Gaussians, width: int, height: int) -> NDArray[np.uint8]:
    """Pixels [height, width, 3], the same on every instruction set and for every number of threads.

    Raises BitstreamError where the Gaussians overlap so much that drawing them would take unbounded time.
    """
    tiles = -(-width // native.TILE_WIDTH) * -(-height // native.TILE_HEIGHT)
    # Fitted pictures touch some 100 Gaussians a tile; a hostile file could make each cover everything.
    max_pairs = 16 * len(gaussians) + 1024 * tiles
    try:
        raster = native.Rasterization(gaussians.means, gaussians.factors, width, height, max_pairs=max_pairs)
    except OverflowError as error:
        raise BitstreamError("the file's Gaussians overlap beyond what a picture needs") from error
    pixels = np.empty((height, width, 3), np.uint8)
    raster.render_bytes(gaussians.colors, pixels)
    return pixels


def decode(data: bytes, max_pixels: int = MAX_PIXELS) -> NDArray[np.uint8]:
    """The picture in an .sg file: [height, width, 3], 8-bit RGB.

    Raises BitstreamError for bytes that are not a whole, intact file, or a picture of more than max_pixels.
    """
    stream = bitstream.parse(data)
    if stream.width * stream.height > max_pixels:
        raise BitstreamError(f"{stream.width} x {stream.height} pixels are more than the limit of {max_pixels}")
    return render_pixels(dequantise(stream), stream.width, stream.height)


def info(data: bytes) -> dict[str, object]:
    """Every header field of an .sg file, and the bits spent on each part. Raises BitstreamError."""
    stream = bitstream.parse(data)
    return {
        "bytes": len(data),
        "bpp": 8 * len(data) / (stream.width * stream.height),
        "version": bitstream.VERSION,
        "profile": stream.profile,
        "width": stream.width,
        "height": stream.height,
        "gaussians": stream.gaussians,
        "position_bits": stream.position_bits,
        "position_range": stream.position_range.tolist(),
        "factor_range": stream.factor_range.tolist(),
        "codebooks": stream.codebooks.astype(np.float64).tolist(),
        "groups": [{"bitwidth": g.bitwidth, "gaussians": len(g.positions)} for g in stream.groups],
        "bits": stream.size_bits(),
    }
