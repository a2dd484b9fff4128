"""Applying a function to any number of items in processes that share the cores.

NumPy is not imported here: a new process first sets its number of threads.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from itertools import islice
from multiprocessing import current_process, get_context, resource_tracker
from multiprocessing.connection import wait
from queue import SimpleQueue
from threading import Thread, current_thread, main_thread
from traceback import format_exc
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from sgmethod import machine
from sgmethod.errors import SgError

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from multiprocessing.process import BaseProcess

ENDED = "its process ended, perhaps because memory ran out: run again with fewer jobs, and resume"
NOT_BEGUN = "a process for a job ended before it began: stderr has its error"
DAEMONIC = "a daemonic process, such as a worker of Celery or of a pool, begins no other: a single job needs none"

MAX_JOBS = 256
MEMORY_OF_JOB = 3 << 29  # bytes: the encode of 24 megapixels takes two thirds of that
PICTURES_OF_JOB = 4  # for fewer, a process takes longer to begin than it saves
CONTEXT = get_context("spawn")  # a copy of this process would have its threads' locks and not its threads

Item = TypeVar("Item")
Result = TypeVar("Result")


def usual_jobs(pictures: int) -> int:
    """Return how many pictures to encode at a time: one for each thread that is set, as far as memory allows."""
    from sgmethod.native import native

    return max(min(native.thread_count(), machine.memory() // MEMORY_OF_JOB, pictures // PICTURES_OF_JOB, MAX_JOBS), 1)


def in_processes(
    function: Callable[[Item], Result], items: Iterable[Item], processes: int
) -> Generator[tuple[Item, Result | None], None, None]:
    """Yield each item and its result as they finish, or None for an item whose process ended.

    Function, items and results are pickled. One item is taken ahead, so there may be any number. Raises SgError if no
    process can begin, OSError if the system allows no more, and what the function raises. Then all processes end.
    """
    if current_process().daemon:
        raise SgError(DAEMONIC)
    workers = _Workers(function, processes)
    try:
        for item in items:
            finished = [workers.finish()] if len(workers.running) == processes else []
            workers.begin(item)
            yield from finished
        while workers.running:
            yield workers.finish()
    finally:
        workers.end()


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
def _uninterrupted() -> Iterator[None]:
    """Put Ctrl-C off while a process begins, which inherits a blocked signal before Python runs in it."""
    if current_thread() is not main_thread():  # no other thread may set a handler
        yield
        return
    late: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: late.append(number))  # other threads may be given it
    if sys.platform != "win32":
        resource_tracker.ensure_running()  # or the first process's start would, which unblocks the signal
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        if sys.platform != "win32":
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, before)
        if late:
            signal.raise_signal(signal.SIGINT)


class _Workers(Generic[Item, Result]):
    """Processes that have one item at a time each, so that it is known which one ended a process.

    running: the items under way, by the pipe to their process.
    """

    def __init__(self, function: Callable[[Item], Result], processes: int) -> None:
        from sgmethod.native import native

        self.running: dict[Connection, Item] = {}
        self._function, self._threads = function, max(native.thread_count() // processes, 1)
        self._processes: dict[Connection, BaseProcess] = {}
        self._starting: set[Connection] = set()
        self._idle: list[Connection] = []

    def begin(self, item: Item) -> None:
        """Give an item to an idle process, or to a new one, which will ask for it."""
        if self._idle:
            pipe = self._idle.pop()
            self._send(pipe, item)
        else:
            pipe, its_end = CONTEXT.Pipe()
            with its_end, _uninterrupted():  # only the process keeps its end open
                process = CONTEXT.Process(target=_work, args=(its_end, self._threads), daemon=True)
                process.start()
                self._processes[pipe] = process
            self._starting.add(pipe)
        self.running[pipe] = item

    def finish(self) -> tuple[Item, Result | None]:
        """Wait until an item is finished, or its process has ended."""
        while True:
            pipe: Any = wait(list(self.running))[0]
            try:
                received = pipe.recv()
            except (EOFError, OSError):
                if pipe in self._starting:
                    raise SgError(NOT_BEGUN) from None
                self._processes.pop(pipe).join()
                return self.running.pop(pipe), None
            if pipe in self._starting:
                self._starting.remove(pipe)
                self._send(pipe, self.running[pipe])
                continue
            if isinstance(received, Exception):
                raise received
            self._idle.append(pipe)
            return self.running.pop(pipe), received

    def end(self) -> None:
        """End all processes at once, whatever they work on."""
        for pipe in self._processes:
            pipe.close()
        for process in self._processes.values():
            process.join()

    def _send(self, pipe: Connection, item: Item) -> None:
        data = pickle.dumps((self._function, item))
        with suppress(OSError):  # the process has ended, as finish() will see
            pipe.send_bytes(data)


def _work(parent: Connection, threads: int) -> None:
    """Work on what the parent sends with this number of threads, ignoring Ctrl-C, until the parent's end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Windows lets nothing be inherited
    received = SimpleQueue[bytes]()
    Thread(target=_receive, args=(parent, received), daemon=True).start()
    os.environ["OPENBLAS_NUM_THREADS"] = str(threads)  # read when numpy is imported
    from sgmethod.native import native

    native.set_thread_count(threads)
    parent.send(None)  # asks for the first item
    while True:
        try:
            function, item = pickle.loads(received.get())
            parent.send(function(item))
        except Exception as error:
            error.add_note(format_exc())
            parent.send(error)


def _receive(parent: Connection, received: SimpleQueue[bytes]) -> None:
    with suppress(EOFError, OSError):
        while True:
            received.put(parent.recv_bytes())
    os._exit(1)
