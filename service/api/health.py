"""Health and metrics: looks at the job table and the storage, and handlers that never wait behind other work."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from anyio import CapacityLimiter, fail_after, to_thread
from fastapi import Response
from prometheus_client import CONTENT_TYPE_LATEST

from service.api.context import Call, UseCall
from service.api.metrics import VERSION
from service.api.problems import ProblemError
from service.errors import JobTableError
from service.jobs.job import Counts
from service.jobs.table import JobTable
from service.storage.files import Storage

log = logging.getLogger(__name__)

OK = {"status": "ok", "version": VERSION}
STALLED_LEASES = 4  # for which jobs may wait while no worker reports
TIMEOUT_S = 2.0  # a part that takes longer counts as unavailable
THREADS = 4  # for each part, of which a hanging one may hold several
T = TypeVar("T")


@dataclass(frozen=True)
class Parts:
    """The state of both parts.

    counts: None if the job table does not respond, or takes no changes; free_bytes: of the storage, infinite for a
    bucket, None if it does not respond.
    """

    counts: Counts | None
    free_bytes: float | None


class Probes:
    """Looks at both parts, in threads that wait for nothing else. Use it in the event loop only."""

    def __init__(self, table: JobTable, storage: Storage) -> None:
        self._table = table
        self._storage = storage
        self._table_threads, self._storage_threads = CapacityLimiter(THREADS), CapacityLimiter(THREADS)
        self._look: asyncio.Future[Parts] | None = None

    async def parts(self) -> Parts:
        """Return what a look finds. It writes to disk, so that one under way answers all who ask meanwhile."""
        if self._look is None or self._look.done():
            self._look = asyncio.ensure_future(self._new_look())
        return await asyncio.shield(self._look)

    async def _new_look(self) -> Parts:
        counts = await self._answer("job table", self._count, self._table_threads)
        return Parts(counts, await self._answer("storage", self._free_bytes, self._storage_threads))

    async def _answer(self, what: str, ask: Callable[[], T], threads: CapacityLimiter) -> T | None:
        try:
            with fail_after(TIMEOUT_S):
                return await to_thread.run_sync(ask, limiter=threads, abandon_on_cancel=True)
        except (JobTableError, OSError) as error:  # TimeoutError too
            log.error("the %s is not responding: %r", what, error)
            return None

    def _count(self) -> Counts:
        self._table.check_writable()
        return self._table.counts()

    def _free_bytes(self) -> float:
        self._storage.check()
        free_bytes = self._storage.free_bytes()
        return math.inf if free_bytes is None else free_bytes


async def live() -> dict[str, str]:
    """Return 200 while the web process runs."""
    return OK


async def ready(call: UseCall) -> dict[str, str]:
    """Return 200 if jobs are accepted and processed.

    The job table and the storage accept writes, the disk has room, the sandbox does tasks, and workers take jobs.
    """
    context, parts = call.context, await _parts(call)
    counts, free_bytes = parts.counts, parts.free_bytes
    if counts is None:
        raise ProblemError(503, "the job table is not responding, or takes no changes", reason="table")
    if free_bytes is None:
        raise ProblemError(503, "the storage is not responding", reason="storage")
    if free_bytes < context.settings.min_free_bytes:
        raise ProblemError(503, f"the disk is almost full: {free_bytes:,.0f} bytes free", reason="disk")
    if counts.waiting_s is not None:
        stalled_s = counts.waiting_s if counts.silent_s is None else min(counts.waiting_s, counts.silent_s)
        if stalled_s > STALLED_LEASES * context.settings.lease_s:
            detail = f"jobs are waiting, and no worker has reported for {stalled_s:.0f} s"
            raise ProblemError(503, detail, reason="stall")
    if trouble := await context.tasks.trouble(TIMEOUT_S):
        log.error("the sandbox is not working: %s", trouble)
        raise ProblemError(503, "the sandbox is not working, so images cannot be read", reason="sandbox")
    return OK


async def metrics(call: UseCall) -> Response:
    """Return metrics in Prometheus' text format."""
    context, parts = call.context, await _parts(call)
    if parts.free_bytes is not None:
        context.metrics.free_bytes.set(parts.free_bytes)
    context.metrics.waits.set(context.waits.total)
    return Response(context.metrics.text(parts.counts), media_type=CONTENT_TYPE_LATEST)


async def _parts(call: Call) -> Parts:
    probes: Probes = call.request.app.state.probes
    return await probes.parts()
