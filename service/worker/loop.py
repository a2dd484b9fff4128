"""The worker: it claims a job, has it encoded by an encoder process, ends the attempt, and claims the next."""

from __future__ import annotations

import contextlib
import logging
import math
import os
import socket
import tempfile
import time
from typing import BinaryIO

from service.jobs.sql import JobTable
from service.jobs.table import Claim, JobTableError
from service.logs import log_seldom
from service.process import confinement
from service.process.background import survived
from service.process.lifeline import Lifeline
from service.process.stopping import StopSignal
from service.settings import Settings
from service.storage.files import Storage, bitstream_key, source_key
from service.worker.encoder import Spec
from service.worker.encoder_process import Crashed, EncoderProcess, Outcome, Preview, TimedOut, TracePoint
from service.worker.heartbeat import PAUSE_AFTER_TROUBLE_S, ClaimLostError, Heartbeat, SignsOfLife
from service.worker.notifying import Notifier
from service.worker.publishing import Publisher, StoppedError
from service.worker.starting import Encoders
from service.worker.sweeping import Sweeper

log = logging.getLogger(__name__)

FOLLOW_S = 0.2  # how soon a request to stop is seen
# A store that copies between places may lack for a while what was just put into it. Four attempts wait for a minute.
MISSING_S = 15.0
SWEEP_ENDS_S = 1.0  # within the grace time; a sweep may be cut short anywhere, and a sign off be missing
THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS")


class Worker:
    """Runs jobs until stopping is requested."""

    def __init__(self, settings: Settings, table: JobTable, storage: Storage, stop: StopSignal) -> None:
        self._settings = settings
        self._table = table
        self._storage = storage
        self._stop = stop
        self._keeps_sources = settings.source_retention_s > 0
        self._publisher = Publisher(table, storage, stop, keeps_sources=self._keeps_sources)
        self._name = f"{socket.gethostname()}:{os.getpid()}"
        self._lifeline = Lifeline()
        # Libraries read these when they are loaded.
        threads = dict.fromkeys(THREAD_VARIABLES, str(settings.encode_threads))
        self._encoders = Encoders({**confinement.environment(os.environ), **threads}, self._lifeline.read_end)

    def run(self) -> None:
        """Claim and work until stopping is requested; sweep meanwhile."""
        log.info("worker %s: ready, %d threads", self._name, self._settings.encode_threads)
        sweeper = Sweeper(self._settings, self._table, self._storage, self._stop)
        sweeper.start()
        signs = SignsOfLife(self._table, self._name, self._stop)
        signs.start()
        for address in self._settings.webhook_addresses:
            Notifier(self._table, address, self._settings.webhook_key, self._stop).start()
        try:
            self._table.deliver(self._run_next, self._stop)
            sweeper.join(SWEEP_ENDS_S)
            signs.join(SWEEP_ENDS_S)
        finally:
            self._encoders.close()
            self._lifeline.close()

    def _run_next(self) -> bool:
        """As run_one; trouble with the job table or the storage is logged and waited out."""
        with survived("running a job"):  # the engine of PostgreSQL would swallow the exception
            try:
                # The codec is imported before a job is claimed, not within its lease.
                return self._encoders.get_ready(self._stop) and self.run_one()
            except (JobTableError, OSError) as error:
                log_seldom(log, "worker %s: %s", self._name, error)
        self._stop.wait(PAUSE_AFTER_TROUBLE_S)
        return False

    def run_one(self) -> bool:
        """Run the next job if there is one; False if none waits. Raises JobTableError, OSError."""
        for job in self._table.reconcile():
            log.warning("job %s failed: its workers were lost %d times", job.id, job.crashes)
            if not self._keeps_sources:
                self._storage.delete(source_key(job.id))
        claim = self._table.claim(self._name)
        if claim is None:
            return False
        log.info("job %s: attempt %d", claim.job_id, claim.attempt)
        heartbeat = Heartbeat(self._table, claim)
        try:
            self._publisher.conclude(claim, self._encode(claim, heartbeat), heartbeat)
        except ClaimLostError:
            log.warning("job %s: attempt %d was taken over by another worker", claim.job_id, claim.attempt)
        except StoppedError:
            log.info("job %s: handed back", claim.job_id)
            self._table.release(claim)
        except OSError:  # such as a storage out of reach: this must not count against the job
            self._table.release(claim)
            raise
        self._publisher.tidy(claim)
        return True

    def _encode(self, claim: Claim, heartbeat: Heartbeat) -> Outcome:
        """Encode in an encoder process, which has ended when this returns.

        Raises ClaimLostError, StoppedError, OSError.
        """
        try:
            source = self._source(claim, heartbeat)
        except FileNotFoundError:
            return Crashed("the source image is gone")
        with (
            source,
            tempfile.TemporaryDirectory(prefix="sgmethod-", ignore_cleanup_errors=True) as folder,
            self._encoders.start(self._spec(claim, folder), source) as process,
        ):
            try:
                return self._follow(process, heartbeat, bitstream_key(claim.job_id, claim.attempt))
            except ValueError as error:
                return Crashed(f"the encoder spoke nonsense: {error}")

    def _source(self, claim: Claim, heartbeat: Heartbeat) -> BinaryIO:
        """The image, once the storage has it. Raises FileNotFoundError if it still lacks it after MISSING_S, and
        ClaimLostError, StoppedError, OSError.
        """
        deadline = time.monotonic() + MISSING_S
        while True:
            try:
                return self._storage.open(source_key(claim.job_id))
            except FileNotFoundError:
                if time.monotonic() >= deadline:
                    raise
            log.warning("job %s: the storage does not have its image yet", claim.job_id)
            if self._stop.wait(PAUSE_AFTER_TROUBLE_S):
                raise StoppedError
            heartbeat.beat()

    def _spec(self, claim: Claim, folder: str) -> Spec:
        threads = self._settings.encode_threads
        return Spec(
            claim.job_id,
            claim.request,
            folder,
            self._lifeline.read_end,
            threads,
            self._settings.job_memory_bytes,
            math.ceil(self._settings.job_timeout_s * (threads + 1)),
        )

    def _follow(self, process: EncoderProcess, heartbeat: Heartbeat, key: str) -> Outcome:
        """Relay progress to the job table, and previews to where the bitstream will lie, until there is an outcome, the
        process dies, or it must be ended.
        """
        started = time.monotonic()
        while not self._stop.requested:
            for message in process.read(FOLLOW_S):
                if isinstance(message, TracePoint):
                    heartbeat.add(message.point)
                    continue
                if isinstance(message, Preview):
                    with contextlib.suppress(OSError):  # nobody needs it
                        self._storage.put(key, message.bitstream)
                    continue
                heartbeat.beat(now=True)
                return message
            if process.ended:
                return Crashed(process.last_words())
            if time.monotonic() - started > self._settings.job_timeout_s:
                return TimedOut(self._settings.job_timeout_s)
            heartbeat.beat()
            if heartbeat.stop_wanted:
                process.end_early()
        raise StoppedError
