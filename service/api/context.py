"""The context of handlers: created once, and passed to each by FastAPI."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, TypeVar

from anyio import CapacityLimiter, to_thread
from fastapi import Depends, Path as PathParameter, Request

from service.api.gate import Caller
from service.api.metrics import Metrics
from service.api.turns import ClientTasks, Shares
from service.jobs.table import JobTable
from service.keys import KeyRing
from service.settings import Settings
from service.storage.files import Storage

WORK_THREADS = 40  # of each kind
T = TypeVar("T")
JobId = Annotated[str, PathParameter(description="32 hexadecimal digits", examples=["0123456789abcdef" * 2])]


class PictureCache:
    """The most recently requested picture files by entity tag, up to max_bytes. Use it in the event loop only."""

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._files: OrderedDict[str, bytes] = OrderedDict()
        self.bytes = 0

    def get(self, etag: str) -> bytes | None:
        if etag in self._files:
            self._files.move_to_end(etag)
        return self._files.get(etag)

    def put(self, etag: str, file: bytes) -> None:
        """Store the file if it fits at all, and evict the oldest files to make space."""
        if etag in self._files or len(file) > self._max_bytes:
            return
        self._files[etag] = file
        self.bytes += len(file)
        while self.bytes > self._max_bytes:
            _, oldest = self._files.popitem(last=False)
            self.bytes -= len(oldest)


@dataclass(frozen=True)
class Context:
    """The parts of the running service.

    tasks: sandbox tasks of clients; waits: requests that wait for a job; unread: bytes of files that clients have not
    read yet; stopping: returns whether the service is shutting down.

    reading, writing, storing: threads in which read() and write() use the job table, and store() the storage. The pools
    are separate, so that a lock or a silent bucket does not block anything else.
    """

    settings: Settings
    table: JobTable
    storage: Storage
    tasks: ClientTasks
    pictures: PictureCache
    waits: Shares
    unread: Shares
    stopping: Callable[[], bool]
    keys: KeyRing
    metrics: Metrics
    reading: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(WORK_THREADS))
    writing: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(WORK_THREADS))
    storing: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(WORK_THREADS))

    async def read(self, ask: Callable[..., T], *values: object) -> T:
        return await to_thread.run_sync(ask, *values, limiter=self.reading)

    async def write(self, change: Callable[..., T], *values: object) -> T:
        return await to_thread.run_sync(change, *values, limiter=self.writing)

    async def store(self, ask: Callable[..., T], *values: object) -> T:
        return await to_thread.run_sync(ask, *values, limiter=self.storing)


@dataclass(frozen=True)
class Call:
    """A request, and the parts of the service that answer it."""

    request: Request
    context: Context

    @property
    def caller(self) -> Caller:
        caller: Caller = self.request.state.caller
        return caller


# Async, since a plain function would wait for a thread of the pool that serves the page's files.
async def _call(request: Request) -> Call:
    return Call(request, request.app.state.context)


UseCall = Annotated[Call, Depends(_call)]
