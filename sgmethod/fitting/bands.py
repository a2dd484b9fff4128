"""Bands of rows, because a large picture as one array of floats would take too much memory."""

from __future__ import annotations

from collections.abc import Callable

from sgmethod.backend.protocol import TILE_HEIGHT
from sgmethod.scene import FloatArray

Rows = Callable[[int, int], FloatArray]  # (first, end) -> rows of a residual, [3, end - first, W]
BAND = 1 << 20  # pixels, about
MIN_ROWS, MULTIPLE = 128, TILE_HEIGHT  # bands must also divide pictures of a half and a quarter of the size


def bands(height: int, width: int) -> list[tuple[int, int]]:
    """Split a picture into bands (first row, end row); first rows are multiples of MULTIPLE."""
    rows = max(BAND // width // MULTIPLE * MULTIPLE, MIN_ROWS)
    return [(first, min(first + rows, height)) for first in range(0, height, rows)]
