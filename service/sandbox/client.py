"""The clients' side of the sandbox: starting it, sending tasks, reading and checking answers."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import select
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Collection, Iterator
from typing import Any, BinaryIO

from service.processes import WATCH_S, PeriodicThread, StopSignal, Supervised
from service.sandbox import frames
from service.sandbox.confinement import environment
from service.settings import Settings
from sgmethod import errors

log = logging.getLogger(__name__)

READ_BYTES = 1 << 18
# A task's own limit counts processor time. This one is for machines with none to spare: proxies give up after 60 s.
TIMEOUT_S = 50.0
TRIES = 2  # a process may have died for another reason than its task
KILLED = "the system killed a task, as it does when memory runs out"
TINY_IMAGE = b"P6 1 1 255 rgb"
MODULE = "service.sandbox.server"
THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS")
ENDS_S = 2.0
# A fork starts without memory of its own: with pages of 2 MB, a picture of 768x512 takes 800 page faults, not 2,000.
HUGE_PAGES = {"GLIBC_TUNABLES": "glibc.malloc.hugetlb=1"}


class SandboxUnavailableError(OSError):
    """The sandbox has died, cannot be started or is too slow, through no fault of the task. Trying again may help."""


class OutOfMemoryError(SandboxUnavailableError):
    """The system killed the task, as it does when memory runs out. Trying again later may help."""


class TaskError(Exception):
    """A task failed through no fault of the service; one sentence."""


class RefusedError(TaskError):
    """The codec refused the file or the options. kind: a class of sgmethod.errors."""

    def __init__(self, kind: type[Exception], detail: str) -> None:
        super().__init__(detail)
        self.kind = kind


class Sandbox:
    """Sends tasks to the sandbox. requests: a socket that it reads, though it may be restarting."""

    def __init__(self, requests: socket.socket) -> None:
        self._requests = requests

    def start(self, task: frames.Task, file: BinaryIO) -> RunningTask:
        """Start a task, which reads the open file from its beginning. Raises SandboxUnavailableError."""
        ours, theirs = socket.socketpair()
        with theirs:
            try:
                message, descriptors = task.model_dump_json().encode(), [theirs.fileno(), file.fileno()]
                socket.send_fds(self._requests, [message], descriptors, socket.MSG_DONTWAIT)
            except OSError as error:  # as when its queue is full
                ours.close()
                raise SandboxUnavailableError(f"the sandbox takes no task: {error}") from error
        return RunningTask(task, ours)

    async def ask(self, task: frames.Task, file: BinaryIO, timeout_s: float | None = None) -> frames.Result[Any]:
        """Return a task's result; cancelling ends it. Raises RefusedError, TaskError, SandboxUnavailableError."""
        timeout_s = timeout_s or max(TIMEOUT_S, 4 * task.cpu_s)
        for left in reversed(range(TRIES)):
            with self.start(task, file) as running:
                try:
                    last = await asyncio.wait_for(running.last(), timeout_s)
                except TimeoutError:
                    raise SandboxUnavailableError("the sandbox cannot be started, or has no processor") from None
                except SandboxUnavailableError:
                    if left:
                        continue
                    raise
            match last:
                case frames.Result():
                    return last
                case frames.Refused(error="MemoryError", detail=detail):
                    raise TaskError(detail)
                case frames.Refused(error=name, detail=detail):
                    raise RefusedError(getattr(errors, name), detail)
                case frames.Crashed(detail=detail):
                    log.warning("a task crashed: %s", detail)
                case frames.Ended(status=status) if status == -signal.SIGPROF:
                    raise TaskError("it exceeds the time limit")
                case frames.Ended(status=status) if status == -signal.SIGKILL:
                    log.warning("%s", KILLED)  # not by us, since the client still waits
                    if not left:
                        raise OutOfMemoryError(KILLED)
        raise TaskError("its decoder crashed")

    async def try_out(self, timeout_s: float) -> None:
        """Read the header of a tiny image. Raises TaskError, OSError."""
        with tempfile.TemporaryFile() as file:
            file.write(TINY_IMAGE)
            file.flush()
            task = frames.ReadHeader(memory_bytes=1 << 28, cpu_s=1.0, max_pixels=1)
            await self.ask(task, file, timeout_s)


class RunningTask:
    """A running task, ended when the context is left. begun: whether the sandbox has started it."""

    def __init__(self, task: frames.Task, connection: socket.socket) -> None:
        self._connection = connection
        self._reader = frames.FrameReader(task)
        self.begun = False
        connection.setblocking(False)

    def __enter__(self) -> RunningTask:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def read(self, timeout_s: float) -> list[frames.Message]:
        """Return the messages that have arrived, after waiting at most timeout_s seconds for one.

        Raises FrameError for an invalid frame, and SandboxUnavailableError.
        """
        if not select.select([self._connection], [], [], timeout_s)[0]:
            return []
        try:
            return self._parse(self._connection.recv(READ_BYTES))
        except ConnectionError:
            return self._parse(b"")

    async def last(self) -> frames.Message:
        """Return the message that ends the task; Crashed after an invalid frame. Raises SandboxUnavailableError."""
        loop = asyncio.get_running_loop()
        while True:
            try:
                messages = self._parse(await loop.sock_recv(self._connection, READ_BYTES))
            except ConnectionError:
                messages = self._parse(b"")
            except frames.FrameError as error:
                return frames.Crashed(detail=f"it sent an invalid message: {error}")
            if messages:
                return messages[0]

    def _parse(self, data: bytes) -> list[frames.Message]:
        if not data:
            raise SandboxUnavailableError("the sandbox has died")
        messages = self._reader.take(data)
        self.begun |= any(isinstance(message, frames.Begun) for message in messages)
        return [message for message in messages if not isinstance(message, frames.Begun)]


class SandboxProcess(Supervised):
    """The process of the sandbox, which kills this one if it hangs. requests: socket that its clients write to.

    absent: layers that tasks may lack, as found at the start: later, a layer may be missing because memory is short.
    Requests written while it is dead are handled by its successor.
    """

    def __init__(self, settings: Settings, absent: Collection[str]) -> None:
        self.requests, self._served = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        # Libraries read these when they load. OpenBLAS has one thread, since forks would lose the others.
        variables = {**dict.fromkeys(THREAD_VARIABLES, str(settings.encode_threads)), "OPENBLAS_NUM_THREADS": "1"}
        number = self._served.fileno()
        command = [sys.executable, "-m", MODULE, str(number), settings.log_format, str(os.getpid()), *absent]
        super().__init__("sandbox", command, (number,), {**HUGE_PAGES, **environment(os.environ), **variables})

    def stop(self, deadline: float) -> None:
        """Let it end, which it does when all its clients have closed their sockets."""
        self.requests.close()
        self._served.close()
        super().stop(deadline)


@contextlib.contextmanager
def own_sandbox(settings: Settings, absent: Collection[str]) -> Iterator[socket.socket]:
    """Run a sandbox for this process only, and provide its socket for requests."""
    process, ended = SandboxProcess(settings, absent), StopSignal()
    keeper = PeriodicThread("keeping the sandbox alive", process.keep_alive, WATCH_S, ended)
    keeper.start()
    try:
        yield process.requests
    finally:
        ended.request()
        keeper.join()
        process.stop(time.monotonic() + ENDS_S)
