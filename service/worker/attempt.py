"""One attempt at a job: its heartbeat while it runs, and how it ends."""

from __future__ import annotations

import hashlib
import logging
import math
import time
from collections.abc import Callable, Sequence
from concurrent import futures
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

from service.errors import JobTableError
from service.jobs.job import FINAL_STATES, EncodeResult, Job, JobError, JsonObject
from service.jobs.table import JobTable
from service.logs import log_seldom
from service.processes import StopSignal
from service.storage.files import Storage, bitstream_key, source_key

T = TypeVar("T")

log = logging.getLogger(__name__)

# Minimum distance of trace points as a share of the time since the start, so that a trace has few points: 10 a second
# at first, and some 500 after five minutes, which a page fetches repeatedly.
POINTS_APART = 1 / 100
HEARTBEAT_S = 0.5  # also how often clients see new progress
PAUSE_AFTER_TROUBLE_S = 1.0  # after an error of the job table or the storage


class ClaimLostError(Exception):
    """The job was cancelled, or belongs to another worker by now."""


class StoppedError(Exception):
    """This worker is stopping."""


@dataclass(frozen=True)
class Encoded:
    """A finished encode."""

    figures: JsonObject
    bitstream: bytes
    notes: Sequence[str] = ()


class Attempt:
    """One attempt at a job, as its worker reports it.

    If the job table or the storage is unavailable at its end, it waits until stopping is requested.
    """

    def __init__(self, table: JobTable, storage: Storage, claim: Job, stop: StopSignal) -> None:
        self._table = table
        self._storage = storage
        self._stop = stop
        self.claim = claim
        self.key = bitstream_key(claim.id, claim.attempt)
        self._points: list[JsonObject] = []  # since the last heartbeat
        self._sent = 0
        self._late: JsonObject | None = None  # the last point, if it came too soon
        self._began = self._heard = time.monotonic()
        self._added = -math.inf
        self._next = self._heard + HEARTBEAT_S

    def add(self, point: JsonObject) -> None:
        """Add a trace point to the next heartbeat. Points that come too soon are dropped, except for the last."""
        now = time.monotonic()
        if now - self._added >= POINTS_APART * (now - self._began):
            self._points.append(point)
            self._late, self._added = None, now
        else:
            self._late = point

    def beat(self, *, now: bool = False) -> None:
        """Renew the lease and send the trace, if it is time to or `now`. Raises ClaimLostError.

        While the job table is unavailable the encode goes on. If another worker has claimed the job meanwhile, the job
        table reports it later.
        """
        if time.monotonic() < self._next and not now:
            return
        if now and self._late is not None:
            self._points.append(self._late)
            self._late = None
        try:
            is_ours = self._table.heartbeat(self.claim, self._points, self._sent)
        except JobTableError as error:
            silence = time.monotonic() - self._heard
            log_seldom(log, "job %s: no heartbeat for %.1f s: %s", self.claim.id, silence, error)
            self._next = time.monotonic() + PAUSE_AFTER_TROUBLE_S
            return
        if not is_ours:
            raise ClaimLostError
        self._heard = time.monotonic()
        self._next = self._heard + HEARTBEAT_S
        self._sent += len(self._points)
        self._points.clear()

    def conclude(self, end: Encoded | JobError) -> None:
        """Publish the bitstream, or record why there is none. A job that crashed is tried again.

        Raises ClaimLostError, StoppedError, JobTableError.
        """
        claim = self.claim
        if isinstance(end, JobError):
            log.warning("job %s: attempt %d %s: %s", claim.id, claim.attempt, end.code, end.detail)
            is_recorded = self._retry(lambda: self._table.fail(claim, end))
        else:
            self._store(end.bitstream)  # before it becomes the job's
            result = EncodeResult(hashlib.sha256(end.bitstream).hexdigest(), end.figures, end.notes)
            is_recorded = self._retry(lambda: self._table.finish(claim, result))
        if not is_recorded:
            raise ClaimLostError
        if isinstance(end, Encoded):
            log.info("job %s: done, %d bytes", claim.id, len(end.bitstream))

    def _store(self, data: bytes) -> None:
        """Store the bitstream, which took long to compute, once there is room. Raises ClaimLostError, StoppedError."""
        while True:
            try:
                self.renewing_lease(lambda: self._storage.put(self.key, data))
                return
            except OSError as error:
                log_seldom(log, "%s cannot be stored yet: %s", self.key, error)
            if self._stop.wait(PAUSE_AFTER_TROUBLE_S):
                raise StoppedError
            self.beat()

    def renewing_lease(self, work: Callable[[], T]) -> T:
        """Return the result of work that may be slow, such as a bucket's, and renew the lease meanwhile.

        Raises ClaimLostError, and what the work raises.
        """
        with ThreadPoolExecutor(1) as pool:
            result = pool.submit(work)
            while futures.wait([result], HEARTBEAT_S).not_done:
                self.beat()
            return result.result()

    def _retry(self, record: Callable[[], bool]) -> bool:
        """Retry until the table records the end of the attempt. Raises JobTableError if the worker is stopping."""
        while True:
            try:
                return record()
            except JobTableError as error:
                log.warning("job %s: its result cannot be recorded yet: %s", self.claim.id, error)
                if self._stop.wait(PAUSE_AFTER_TROUBLE_S):
                    raise

    def remove_leftovers(self) -> None:
        """Remove the image of a job that will not run again, and files of an unsuccessful attempt."""
        job = self._table.get(self.claim.id)
        if job is None or (job.state, job.attempt) != ("done", self.claim.attempt):
            self._storage.delete(self.key)
        if job is None or (job.state in FINAL_STATES and not self._table.keeps_sources):
            self._storage.delete(source_key(self.claim.id))
