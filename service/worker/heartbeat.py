"""The heartbeat of a claim. It renews the lease, brings the trace to the job table, and hears of a stop there."""

from __future__ import annotations

import contextlib
import logging
import threading
import time

from service.jobs.job import JsonObject
from service.jobs.sql import JobTable
from service.jobs.table import Claim, JobTableError
from service.process.background import failures, survived
from service.process.stopping import StopSignal

log = logging.getLogger(__name__)

HEARTBEAT_S = 0.5  # how fresh the progress is that a client sees
SIGN_S = 5.0
PAUSE_AFTER_TROUBLE_S = 1.0  # with the job table or the storage


class SignsOfLife(threading.Thread):
    """Tells the job table from time to time that a worker lives, until it is to stop.

    Beside the worker's own thread, which may wait for the storage, or for a job.
    """

    def __init__(self, table: JobTable, worker: str, until: StopSignal) -> None:
        super().__init__(name="signs", daemon=True)
        self._table = table
        self._worker = worker
        self._until = until

    def run(self) -> None:
        while True:
            # A table out of reach hears of it later, or notices the silence.
            with survived("signing"), contextlib.suppress(JobTableError):
                self._table.sign(self._worker, failures.total())
            if self._until.wait(SIGN_S):
                break
        with contextlib.suppress(JobTableError):
            self._table.sign_off(self._worker)


class ClaimLostError(Exception):
    """The job was cancelled, or is another worker's by now."""


class Heartbeat:
    """The heartbeat of one claim, with the trace points that came in since the last beat."""

    def __init__(self, table: JobTable, claim: Claim) -> None:
        self._table = table
        self._claim = claim
        self._points: list[JsonObject] = []
        self._sent = 0
        self.stop_wanted = False  # whether this attempt is to end early, with what it has
        self._heard = time.monotonic()
        self._next = self._heard + HEARTBEAT_S

    def add(self, point: JsonObject) -> None:
        """Note a trace point for the next beat."""
        self._points.append(point)

    def beat(self, *, now: bool = False) -> None:
        """Renew the lease, if it is time to or at once. Raises ClaimLostError.

        While the job table is out of reach the encode goes on. Perhaps no other worker has claimed the job
        meanwhile; if one has, the job table says so later.
        """
        if time.monotonic() < self._next and not now:
            return
        try:
            alive = self._table.heartbeat(self._claim, self._points, self._sent)
            self.stop_wanted = alive and self._table.stop_wanted(self._claim)
        except JobTableError as error:
            silence = time.monotonic() - self._heard
            log.warning("job %s: no heartbeat for %.1f s: %s", self._claim.job_id, silence, error)
            self._next = time.monotonic() + PAUSE_AFTER_TROUBLE_S
            return
        if not alive:
            raise ClaimLostError
        self._heard = time.monotonic()
        self._next = self._heard + HEARTBEAT_S
        self._sent += len(self._points)
        self._points.clear()
