"""The texture part of a version 2 file: codes of strengths <-> bits (docs/format.md).

A code is stored as its difference from the code on its left or, at the start of a row, from the code above. Small
differences are likelier, so they take fewer bits: the differences 0, -1, 1, -2, ... become 0, 1, 2, 3, ... ones, and
then a zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sgmethod.errors import BitstreamError
from sgmethod.native import native

Codes = NDArray[np.uint8]  # [octaves, rows, columns]


def cells(width: int, height: int) -> tuple[int, int]:
    """Count the rows and columns of cells in a picture of this size in pixels."""
    return -(-height // native.TEXTURE_CELL), -(-width // native.TEXTURE_CELL)


def pack(codes: Codes) -> bytes:
    """Write the texture part."""
    stored = codes.astype(np.int64)
    stored[1:] -= stored[:-1].copy()  # a finer octave predicts the next
    first = np.diff(stored[:, :, :1], axis=1, prepend=0)
    steps = np.concatenate([first, np.diff(stored, axis=2)], 2).ravel()
    ones = np.where(steps < 0, -2 * steps - 1, 2 * steps)
    bits = np.ones(ones.sum() + len(ones), np.uint8)
    bits[np.cumsum(ones + 1) - 1] = 0
    return np.packbits(bits).tobytes()


def unpack(data: bytes, width: int, height: int) -> tuple[Codes, int]:
    """Read the codes for a picture of this size in pixels; also return the bytes read. Raises BitstreamError."""
    try:
        return native.unpack_texture(data, width, height)
    except RuntimeError as error:
        raise BitstreamError(str(error)) from error
