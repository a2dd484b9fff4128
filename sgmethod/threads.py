"""The number of threads, and a pool of them for NumPy and OpenCV, which release Python's lock while they compute."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

from sgmethod.budget import checked_integer
from sgmethod.native import native

MAX_THREADS = 256
Item = TypeVar("Item")
Result = TypeVar("Result")


def set_threads(count: int) -> None:
    """Set the number of threads for decoding and encoding in this process, 1 to 256.

    The default is SG_THREADS, or else the number of cores that the process and its control group may use. Raises
    SgError.
    """
    native.set_thread_count(checked_integer(count, "the number of threads", 1, MAX_THREADS))


def in_parallel(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Map a function over items on as many threads as the kernels use; results in order.

    The first error is raised. The function must not call in_parallel() itself.
    """
    threads, items = native.thread_count(), list(items)
    if threads > 1:
        pool = _pool(threads)
        try:
            return list(pool.map(function, items))
        except RuntimeError:  # no more threads allowed; an error of the function itself is raised again below
            _pool.cache_clear()
            pool.shutdown()
    return [function(item) for item in items]


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Thread pool, kept because starting threads takes as long as computing a small picture."""
    return ThreadPoolExecutor(threads, "sgmethod")


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_pool.cache_clear)  # a forked child has none of the pool's threads
