"""Looks at the job table and the storage, for /readyz and /metrics."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from anyio import CapacityLimiter, fail_after, to_thread

from service.errors import JobTableError
from service.jobs.job import Counts
from service.jobs.table import JobTable
from service.storage.files import Storage

log = logging.getLogger(__name__)

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
