"""The largest file within a number of bytes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache


def last_within(size: Callable[[int], float], limit: float, low: int, high: int, near: int = 1) -> int:
    """Bisect for the last number of at most this size, between low, which counts as within, and high, which does not.

    size: of the number's file, which rises with it. near: ends the search when low and high are no further apart.

    >>> last_within(lambda quality: 10 * quality, 455, 0, 101)
    45
    """
    while high - low > near:
        middle = (low + high) // 2
        low, high = (middle, high) if size(middle) <= limit else (low, middle)
    return low


def largest_within(encode: Callable[[int], bytes], max_bytes: int, low: int, high: int, near: int = 1) -> bytes:
    """Find the largest file of at most so many bytes among the qualities above low and below high; b"" if none is."""
    encoded = cache(encode)
    best = last_within(lambda quality: len(encoded(quality)), max_bytes, low, high, near)
    return encoded(best) if best > low else b""
