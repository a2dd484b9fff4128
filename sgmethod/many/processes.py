"""Applying a function to any number of items in processes that share the cores.

NumPy is not imported here: a new process first sets its number of threads.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from itertools import islice
from multiprocessing import get_context
from multiprocessing.sharedctypes import RawValue
from threading import Thread, current_thread, main_thread
from typing import TYPE_CHECKING, TypeVar

from sgmethod.errors import SgError

if TYPE_CHECKING:
    from ctypes import c_byte
    from multiprocessing.connection import Connection

KILLED = "its process was killed, perhaps because memory ran out"
NONE_BEGINS = (
    "no process for a job can begin; stderr has its error. The system may allow no more processes or threads, or a "
    """script asks for several: run it as a file and guard it with `if __name__ == "__main__":`"""
)

MAX_JOBS = 256
CONTEXT = get_context("spawn")  # a copy of this process would have its threads' locks and not its threads

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_processes(
    function: Callable[[Item], Result], items: Iterable[Item], processes: int
) -> Generator[tuple[Item, Result | None], None, None]:
    """Yield each item with its result, as they finish; None if its process was killed twice, the second time alone.

    Function, items and results are pickled. Few items are taken ahead, so there may be any number. Raises SgError if
    no process can begin, or the system allows no more.
    """
    waiting = iter(items)
    with _limits_named():
        begun = RawValue("b", 0)  # an Event has a lock, which a killed process may hold for ever
    while True:
        running: dict[Future[Result], Item] = {}
        with _pool(processes, begun) as pool, suppress(BrokenProcessPool):
            while True:
                for item in islice(waiting, 2 * processes - len(running)):
                    running[_submitted(pool, function, item)] = item
                if not running:
                    return
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    result = future.result()
                    yield running.pop(future), result
        if not begun.value:
            raise SgError(NONE_BEGINS)
        for item in running.values():  # one of them ended its process, and with it the pool
            alone = None
            with _pool(1, begun) as pool, suppress(BrokenProcessPool):
                alone = _submitted(pool, function, item).result()
            yield item, alone


@contextmanager
def _pool(processes: int, begun: c_byte) -> Iterator[ProcessPoolExecutor]:
    """A pool whose processes share the cores. They end at once if an error leaves the block, or if this one ends."""
    from sgmethod.native import native

    threads = max(native.thread_count() // processes, 1)
    with _limits_named():
        watched, held = CONTEXT.Pipe(duplex=False)  # the system closes it too, if this process is killed
        pool = ProcessPoolExecutor(processes, CONTEXT, _begin, (threads, begun, watched))
    try:
        yield pool
    except BaseException:
        held.close()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        held.close()
        watched.close()


def _submitted(pool: ProcessPoolExecutor, function: Callable[[Item], Result], item: Item) -> Future[Result]:
    """Submit an item; where the pool is broken already, the result is this error."""
    try:
        with _limits_named(), _uninterrupted():
            return pool.submit(function, item)
    except BrokenProcessPool as error:
        future: Future[Result] = Future()
        future.set_exception(error)
        return future


@contextmanager
def _limits_named() -> Iterator[None]:
    """Raise SgError where the system allows no more processes, or has no semaphores (/dev/shm) for any."""
    try:
        yield
    except BrokenProcessPool:
        raise
    except (OSError, RuntimeError, ImportError) as error:
        raise SgError(f"no further process can begin: {error}; a single job needs none") from error


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Ignore Ctrl-C while a process begins: it inherits that before Python runs in it."""
    if current_thread() is not main_thread():  # no other thread may set a handler
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _begin(threads: int, begun: c_byte, watched: Connection) -> None:
    """Set up a process that ends when `watched` is closed, ignores Ctrl-C and has this number of threads."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Windows lets nothing be inherited
    Thread(target=_end_with, args=(watched,), daemon=True).start()
    os.environ["OPENBLAS_NUM_THREADS"] = str(threads)  # read when numpy is imported
    from sgmethod.native import native

    native.set_thread_count(threads)
    begun.value = 1


def _end_with(watched: Connection) -> None:
    watched.poll(None)
    os._exit(1)
