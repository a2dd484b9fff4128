"""What numpy and OpenCV compute, on as many threads as the kernels have: both let go of Python's lock meanwhile."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

from sgmethod.native import native

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_parallel(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """The result for each item, in their order. The first error is raised; a function must not call this itself."""
    threads, items = native.thread_count(), list(items)
    if threads > 1:
        pool = _pool(threads)
        try:
            return list(pool.map(function, items))
        except RuntimeError:  # the system allows no more threads, or the error is the function's, which raises it again
            _pool.cache_clear()
            pool.shutdown()
    return [function(item) for item in items]


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Kept, since to start threads takes as long as a small picture."""
    return ThreadPoolExecutor(threads, "sgmethod")


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_pool.cache_clear)  # which has none of its threads
