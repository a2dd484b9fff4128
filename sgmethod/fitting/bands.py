"""Bands of rows, because a large picture as one array of floats would take too much memory, and strips for threads."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from sgmethod.backend.protocol import TILE_HEIGHT, thread_count
from sgmethod.scene import FloatArray
from sgmethod.threads import in_parallel

Result = TypeVar("Result")

Rows = Callable[[int, int], FloatArray]  # (first, end) -> rows of a residual, [3, end - first, W]
BAND = 1 << 20  # pixels, about
STRIP = 32  # least rows of a strip: few beside the rows around it that a blur needs
MIN_ROWS, MULTIPLE = 128, TILE_HEIGHT  # bands must also divide pictures of a half and a quarter of the size


def bands(height: int, width: int) -> list[tuple[int, int]]:
    """Split a picture into bands (first row, end row); first rows are multiples of MULTIPLE."""
    rows = max(BAND // width // MULTIPLE * MULTIPLE, MIN_ROWS)
    return [(first, min(first + rows, height)) for first in range(0, height, rows)]


def parallel_rows(function: Callable[[int, int], Result], rows: int, min_rows: int = STRIP) -> list[Result]:
    """Call a function with the first and the end row of strips, in parallel; results in order.

    First rows are even, and depend on the number of threads: the function's results must not.
    """
    count = max(min(thread_count(), rows // min_rows), 1)
    if count == 1:
        return [function(0, rows)]  # whose kernels may use all threads
    ends = [rows * number // count // 2 * 2 for number in range(count)] + [rows]
    return in_parallel(lambda number: function(ends[number], ends[number + 1]), range(count))
