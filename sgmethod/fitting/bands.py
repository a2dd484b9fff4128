"""Bands of rows: a large picture as one array of floats would take too much memory."""

from __future__ import annotations

from collections.abc import Callable

from sgmethod.scene import FloatArray

# A residual, from the first row to before another: [3, rows, W].
Rows = Callable[[int, int], FloatArray]
BAND = 1 << 20  # pixels, about
LEAST_ROWS, MULTIPLE = 128, 4  # so that bands fit pictures of a half and a quarter of the size


def bands(height: int, width: int) -> list[tuple[int, int]]:
    """The first row of each band, a multiple of MULTIPLE, and that before which it ends."""
    rows = max(BAND // width // MULTIPLE * MULTIPLE, LEAST_ROWS)
    return [(first, min(first + rows, height)) for first in range(0, height, rows)]
