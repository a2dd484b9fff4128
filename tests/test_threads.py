"""Work on several threads."""

from __future__ import annotations

import threading

import pytest

import sgmethod
from sgmethod.native import native
from sgmethod.threads import in_parallel


def test_results_are_in_order_and_made_by_as_many_threads_as_told() -> None:
    before = native.thread_count()
    try:
        sgmethod.set_threads(2)
        both = threading.Barrier(2)
        names = in_parallel(lambda _: (both.wait(60), threading.current_thread().name)[1], range(2))
        assert len(set(names)) == 2
        assert in_parallel(lambda n: n * n, range(50)) == [n * n for n in range(50)]
        sgmethod.set_threads(1)
        assert in_parallel(lambda _: threading.current_thread(), range(3)) == [threading.current_thread()] * 3
    finally:
        sgmethod.set_threads(before)


@pytest.mark.parametrize("threads", [1, 2])
def test_the_first_error_is_raised(threads: int) -> None:
    before = native.thread_count()
    try:
        sgmethod.set_threads(threads)
        with pytest.raises(ZeroDivisionError):
            in_parallel(lambda n: 1 // n, [1, 0, 2])
    finally:
        sgmethod.set_threads(before)
