"""Applying a function to any number of items in processes that share the cores.

NumPy is not imported here: a new process first sets its number of threads.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from multiprocessing.sharedctypes import RawValue
from threading import Thread, current_thread, main_thread
from typing import TYPE_CHECKING, TypeVar

from sgmethod.errors import SgError

if TYPE_CHECKING:
    from ctypes import c_byte
    from multiprocessing.process import BaseProcess

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
    with _limits_said():
        begun = RawValue("b", 0)  # an Event has a lock, which a killed process may hold for ever
    while lost := (yield from _until_killed(function, waiting, processes, 2 * processes, begun)):
        if not begun.value:
            raise SgError(NONE_BEGINS)
        # One of them ended its process, and with it the pool. Each is tried again alone.
        suspects = iter(lost)
        while killed := (yield from _until_killed(function, suspects, 1, 1, begun)):
            yield killed[0], None


def _until_killed(
    function: Callable[[Item], Result], waiting: Iterator[Item], processes: int, ahead: int, begun: c_byte
) -> Generator[tuple[Item, Result], None, list[Item]]:
    """Yield items with their results; return those under way when a process was killed, or none at the end."""
    from sgmethod.native import native

    threads = max(native.thread_count() // processes, 1)
    running: dict[Future[Result], Item] = {}
    lost: list[Item] = []
    with _limits_said():
        made = ProcessPoolExecutor(processes, CONTEXT, _begin, (threads, begun))
    with made as pool:
        try:
            while True:
                while not lost and len(running) < ahead:
                    try:
                        item = next(waiting)
                    except StopIteration:
                        break
                    try:
                        with _limits_said(), _uninterrupted():
                            running[pool.submit(function, item)] = item
                    except BrokenProcessPool:
                        lost.append(item)
                if not running:
                    return lost
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    item = running.pop(future)
                    try:
                        result = future.result()
                    except BrokenProcessPool:
                        lost.append(item)
                    else:
                        yield item, result
        except BaseException:
            own = list(pool._processes.values())  # shutdown() forgets them
            pool.shutdown(wait=False, cancel_futures=True)
            for process in own:
                process.terminate()
            raise


@contextmanager
def _limits_said() -> Iterator[None]:
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


def _begin(threads: int, begun: c_byte) -> None:
    """Set up a process that ends with its parent, ignores Ctrl-C and has this number of threads."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Windows lets nothing be inherited
    parent = parent_process()
    if parent is not None:
        Thread(target=_end_with, args=(parent,), daemon=True).start()
    os.environ["OPENBLAS_NUM_THREADS"] = str(threads)  # read when numpy is imported
    from sgmethod.native import native

    native.set_thread_count(threads)
    begun.value = 1


def _end_with(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)
