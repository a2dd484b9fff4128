"""How an attempt ends: its bitstream is published, or the reason of its failure goes to the job table."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable
from dataclasses import dataclass

from service.jobs.job import FINAL_STATES, EncodeResult, JobError, JsonObject
from service.jobs.sql import JobTable
from service.jobs.table import Claim, JobTableError
from service.logs import log_seldom
from service.process.stopping import StopSignal
from service.storage.files import Storage, bitstream_key, source_key
from service.worker.heartbeat import PAUSE_AFTER_TROUBLE_S, ClaimLostError, Heartbeat

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Encoded:
    """The encode is done."""

    stats: JsonObject
    bitstream: bytes


class StoppedError(Exception):
    """This worker is to stop."""


class Publisher:
    """Ends attempts. It waits while the job table or the storage is out of reach, until stopping is requested.

    keeps_sources: images of finished jobs stay for the sweep, and may be encoded again until then.
    """

    def __init__(self, table: JobTable, storage: Storage, stop: StopSignal, *, keeps_sources: bool = False) -> None:
        self._table = table
        self._storage = storage
        self._stop = stop
        self._keeps_sources = keeps_sources

    def conclude(self, claim: Claim, outcome: Encoded | JobError, heartbeat: Heartbeat) -> None:
        """Publish the bitstream, or tell the job table why there is none. A job that crashed is tried again.

        Raises ClaimLostError, StoppedError, JobTableError.
        """
        if isinstance(outcome, Encoded):
            self._publish(claim, outcome, heartbeat)
            return
        log.warning("job %s: attempt %d %s: %s", claim.job_id, claim.attempt, outcome.code, outcome.detail)
        retry = outcome.code == "crashed"
        if not self._insist(claim, lambda: self._table.fail(claim, outcome, retry=retry)):
            raise ClaimLostError

    def _publish(self, claim: Claim, encoded: Encoded, heartbeat: Heartbeat) -> None:
        """Store the bitstream, then make it the job's in one update."""
        key = bitstream_key(claim.job_id, claim.attempt)
        self._store(key, encoded.bitstream, heartbeat)
        result = EncodeResult(key, hashlib.sha256(encoded.bitstream).hexdigest(), encoded.stats)
        if not self._insist(claim, lambda: self._table.finish(claim, result)):
            self._storage.delete(key)
            raise ClaimLostError
        log.info("job %s: done, %d bytes", claim.job_id, len(encoded.bitstream))

    def _store(self, key: str, data: bytes, heartbeat: Heartbeat) -> None:
        """Store the bitstream, which took long to compute, however long the disk stays full.

        Raises ClaimLostError, StoppedError.
        """
        while True:
            try:
                self._storage.put(key, data)
                return
            except OSError as error:
                log_seldom(log, "%s cannot be stored yet: %s", key, error)
            if self._stop.wait(PAUSE_AFTER_TROUBLE_S):
                raise StoppedError
            heartbeat.beat()

    def _insist(self, claim: Claim, last_word: Callable[[], bool]) -> bool:
        """Try again until the table has the end of the attempt. Raises JobTableError if this worker is to stop."""
        while True:
            try:
                return last_word()
            except JobTableError as error:
                log.warning("job %s: its result cannot be recorded yet: %s", claim.job_id, error)
                if self._stop.wait(PAUSE_AFTER_TROUBLE_S):
                    raise

    def tidy(self, claim: Claim) -> None:
        """Remove the source image of a job that will not run again, and what an attempt without a result has left."""
        job, key = self._table.get(claim.job_id), bitstream_key(claim.job_id, claim.attempt)
        if job is None or job.result is None or job.result.bitstream_key != key:
            self._storage.delete(key)
        if job is None or (job.state in FINAL_STATES and not self._keeps_sources):
            self._storage.delete(source_key(claim.job_id))
