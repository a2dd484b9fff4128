"""Bytes -> Gaussians -> 8-bit pixels. No torch here."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sgmethod.bitstream import v1, v3
from sgmethod.bitstream.v1 import Stream
from sgmethod.errors import BitstreamError, ViewError
from sgmethod.native import native
from sgmethod.scene import Gaussians
from sgmethod.view import View

WHOLE = View()
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


def render_pixels(
    gaussians: Gaussians,
    width: int,
    height: int,
    background: tuple[int, int, int] = (0, 0, 0),
    cutoff: float = v1.CUTOFF,
) -> NDArray[np.uint8]:
    """Pixels [height, width, 3] of Gaussians, which end at sigma = cutoff, over an 8-bit background colour.

    They are the same on every instruction set and for every number of threads.

    Raises BitstreamError where the Gaussians overlap so much that drawing them would take unbounded time.
    """
    tiles = -(-width // native.TILE_WIDTH) * -(-height // native.TILE_HEIGHT)
    # Fitted pictures come to at most a fifth of this (six pictures from 0.03 to 12 bpp, noise and a constant among
    # them); a hostile file could make every Gaussian cover everything.
    max_pairs = 16 * len(gaussians) + 256 * tiles
    try:
        raster = native.Rasterization(gaussians.means, gaussians.factors, width, height, cutoff, max_pairs=max_pairs)
    except OverflowError as error:
        raise BitstreamError("the file's Gaussians overlap beyond what a picture needs") from error
    pixels = np.empty((height, width, 3), np.uint8)
    red, green, blue = (level / 255 for level in background)
    raster.render_bytes(gaussians.colors, pixels, (red, green, blue))
    return pixels


def decode(data: bytes, max_pixels: int = MAX_PIXELS, view: View = WHOLE) -> NDArray[np.uint8]:
    """The picture in an .sg file, or a view of it: [height, width, 3], 8-bit RGB.

    Raises BitstreamError for bytes that are not a whole, intact file, or a picture or view of more than max_pixels;
    ViewError for a view that makes no picture of it.
    """
    if _version(data) == v3.VERSION:
        coded = v3.parse(data, max_pixels)
        size, gaussians = (coded.width, coded.height), coded.gaussians(view.prefix)
        background, cutoff = coded.background, v3.CUTOFF
    else:
        stream = v1.parse(data, max_pixels)
        if view.prefix < 1:
            raise ViewError(f"profile {stream.profile} has no order that a prefix could follow")
        size, gaussians = (stream.width, stream.height), dequantise(stream)
        background, cutoff = (0, 0, 0), v1.CUTOFF
    width, height = view.size(*size)
    if width * height > max_pixels:
        raise BitstreamError(f"{width} x {height} pixels are more than the limit of {max_pixels}")
    return render_pixels(view.apply(gaussians, *size, cutoff), width, height, background, cutoff)


def _version(data: bytes) -> int:
    """The version byte, or 0 where v1.parse will refuse the data."""
    return data[3] if len(data) > 3 and data[:3] == v1.MAGIC else 0


def info(data: bytes, max_gaussians: int | None = None) -> dict[str, object]:
    """Every header field of an .sg file, and the bits spent on each part.

    Raises BitstreamError, also for more than max_gaussians, before memory is taken for them.
    """
    if _version(data) == v3.VERSION:
        return _rd_info(data, max_gaussians)
    stream = v1.parse(data, max_gaussians=max_gaussians)
    return {
        "bytes": len(data),
        "bpp": 8 * len(data) / (stream.width * stream.height),
        "version": v1.VERSION,
        "checksum": data[4:8].hex(),
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


def _rd_info(data: bytes, max_gaussians: int | None) -> dict[str, object]:
    stream = v3.parse(data)
    return {
        "bytes": len(data),
        "bpp": 8 * len(data) / (stream.width * stream.height),
        "version": v3.VERSION,
        "checksum": data[4:8].hex(),
        "profile": "rd",
        "width": stream.width,
        "height": stream.height,
        "gaussians": len(stream.gaussians(max_gaussians=max_gaussians)),
        "quantum": stream.quantum,
        "background": list(stream.background),
        "grey": stream.grey,
        "upright": stream.upright,
        "bits": stream.size_bits(),
    }
