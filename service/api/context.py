"""The context of handlers: created once, and passed to each by FastAPI."""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, TypeVar

from anyio import CapacityLimiter, to_thread
from fastapi import Depends, Path as PathParameter, Request

from service.api.gate import Caller
from service.api.metrics import Metrics
from service.api.probes import Probes
from service.api.problems import ProblemError
from service.api.turns import ClientTasks, Shares
from service.jobs.job import Job, is_job_id
from service.jobs.table import JobTable
from service.keys import KeyRing
from service.settings import Settings
from service.storage.files import Storage

log = logging.getLogger(__name__)

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
    probes: Probes
    reading: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(WORK_THREADS))
    writing: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(WORK_THREADS))
    storing: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(WORK_THREADS))

    async def read(self, ask: Callable[..., T], *values: object) -> T:
        return await to_thread.run_sync(ask, *values, limiter=self.reading)

    async def write(self, change: Callable[..., T], *values: object) -> T:
        return await to_thread.run_sync(change, *values, limiter=self.writing)

    async def store(self, ask: Callable[..., T], *values: object) -> T:
        return await to_thread.run_sync(ask, *values, limiter=self.storing)

    def discard(self, key: str) -> None:
        """Remove a file that no job needs. If that fails, the sweep removes it later."""
        try:
            self.storage.delete(key)
        except OSError as error:
            log.warning("%s cannot be removed yet: %s", key, error)


def context_of(request: Request) -> Context:
    """Return the context of the application that handles this request."""
    context: Context = request.app.state.context
    return context


# Async, since plain functions would wait for a thread of the pool that serves the page's files.
async def _context(request: Request) -> Context:
    return context_of(request)


async def _caller(request: Request) -> Caller:
    caller: Caller = request.state.caller
    return caller


UseContext = Annotated[Context, Depends(_context)]
UseCaller = Annotated[Caller, Depends(_caller)]


def no_such_job() -> ProblemError:
    """Return the answer to an id without a job, whether or not the id is well formed."""
    return ProblemError(404, "there is no such job")


async def known_job(request: Request, job_id: str) -> Job:
    """Return the job if the caller may see it. A job of another owner looks like none. Raises ProblemError 404."""
    context, caller = context_of(request), request.state.caller
    if not is_job_id(job_id) or caller.linked_job not in (None, job_id):
        raise no_such_job()
    job = await context.read(context.table.get, job_id, caller.owner)
    if job is None:
        raise no_such_job()
    return job
