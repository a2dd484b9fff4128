"""Applying a function to any number of items in processes that share the cores.

NumPy is not imported here: a new process first sets its number of threads.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from multiprocessing import get_context
from queue import SimpleQueue
from threading import Thread, current_thread, main_thread
from typing import TYPE_CHECKING, TypeVar

from sgmethod import machine
from sgmethod.errors import SgError

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

ENDED = (
    "a process for a job ended, perhaps because memory ran out: run again with fewer jobs, and resume; if none began, "
    """stderr has its error, and a script that asks for several needs `if __name__ == "__main__":`"""
)

MAX_JOBS = 256
MEMORY_OF_JOB = 3 << 29  # bytes: the encode of 24 megapixels takes two thirds of that
PICTURES_OF_JOB = 4  # for fewer, a process takes longer to begin than it saves
CONTEXT = get_context("spawn")  # a copy of this process would have its threads' locks and not its threads

Item = TypeVar("Item")
Result = TypeVar("Result")


def usual_jobs(pictures: int) -> int:
    """Return how many pictures to encode at a time: one for each thread that is set, as far as memory allows."""
    from sgmethod.native import native

    jobs = min(native.thread_count(), machine.memory() // MEMORY_OF_JOB, pictures // PICTURES_OF_JOB, MAX_JOBS)
    try:
        CONTEXT.Semaphore()
    except (OSError, ImportError):  # as in AWS Lambda
        return 1
    return max(jobs, 1)


def in_processes(
    function: Callable[[Item], Result], items: Iterable[Item], processes: int
) -> Generator[Result, None, None]:
    """Yield the result of each item, as they finish.

    Function, items and results are pickled. Few items are taken ahead, so there may be any number. Raises SgError if a
    process is killed or none can begin, and OSError if the system allows no more.
    """
    with _pool(processes) as pool:

        def begin(item: Item) -> Future[Result]:
            with _uninterrupted():
                return pool.submit(function, item)

        for _, future in as_they_finish(begin, items, 2 * processes):
            yield future.result()


def as_they_finish(
    begin: Callable[[Item], Future[Result]], items: Iterable[Item], limit: int
) -> Iterator[tuple[Item, Future[Result]]]:
    """Yield each item and its future as they finish, beginning further ones so that `limit` are under way.

    If the loop ends early, those that have not begun are cancelled.
    """
    waiting = iter(items)
    running: dict[Future[Result], Item] = {}
    finished: SimpleQueue[Future[Result]] = SimpleQueue()  # wait() would go through all of them for each that is done
    try:
        while True:
            for item in islice(waiting, limit - len(running)):
                future = begin(item)
                running[future] = item
                future.add_done_callback(finished.put)
            if not running:
                return
            future = finished.get()
            yield running.pop(future), future
    finally:
        for future in running:
            future.cancel()


@contextmanager
def _pool(processes: int) -> Iterator[ProcessPoolExecutor]:
    """A pool whose processes share the cores. They end at once if an error leaves the block, or if this one ends."""
    from sgmethod.native import native

    threads = max(native.thread_count() // processes, 1)
    watched, held = CONTEXT.Pipe(duplex=False)  # the system closes it too, if this process is killed
    try:
        pool = ProcessPoolExecutor(processes, CONTEXT, _begin, (threads, watched))
    except (OSError, ImportError) as error:  # there are no semaphores, as in AWS Lambda
        raise SgError(f"no further process can begin: {error}; a single job needs none") from error
    try:
        yield pool
    except BrokenProcessPool as error:
        raise SgError(ENDED) from error
    except BaseException:
        held.close()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        held.close()
        watched.close()


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Put Ctrl-C off while a process begins, which inherits a blocked signal before Python runs in it."""
    if current_thread() is not main_thread():  # no other thread may set a handler
        yield
        return
    late: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: late.append(number))  # other threads may be given it
    if sys.platform != "win32":
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        if sys.platform != "win32":
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, before)
        if late:
            signal.raise_signal(signal.SIGINT)


def _begin(threads: int, watched: Connection) -> None:
    """Set up a process that ends when `watched` is closed, ignores Ctrl-C and has this number of threads."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Windows lets nothing be inherited
    Thread(target=_end_with, args=(watched,), daemon=True).start()
    os.environ["OPENBLAS_NUM_THREADS"] = str(threads)  # read when numpy is imported
    from sgmethod.native import native

    native.set_thread_count(threads)


def _end_with(watched: Connection) -> None:
    watched.poll(None)
    os._exit(1)
