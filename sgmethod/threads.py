"""The number of threads of the kernels, on which NumPy, OpenCV and zlib can run in parallel too."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

from sgmethod.arguments import AnyInt, checked_integer
from sgmethod.native import native
from sgmethod.numerics import quiet

MAX_THREADS = 256
Item = TypeVar("Item")
Result = TypeVar("Result")


def set_threads(count: AnyInt) -> None:
    """Set the number of threads for decoding and encoding in this process, 1 to 256.

    The default is SG_THREADS, or else the number of cores that the process and its control group may use. Raises
    SgError.
    """
    native.set_thread_count(checked_integer(count, "the number of threads", 1, MAX_THREADS))


def in_parallel(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Map a function over items on the kernels' threads; results in order. The first error is raised.

    No lock of Python's is involved, which an interrupt could leave taken.
    """
    items = list(items)
    results: dict[int, Result] = {}

    @quiet
    def compute(index: int) -> None:
        results[index] = function(items[index])

    native.in_parallel(len(items), compute)
    return [results[index] for index in range(len(items))]
