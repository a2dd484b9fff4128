"""The worker: it claims a job, has it encoded in the sandbox, ends the attempt, and claims the next."""

from __future__ import annotations

import functools
import io
import logging
import math
import os
import signal
import socket
import time
from typing import BinaryIO

from service.jobs.job import Job, JobError
from service.jobs.table import IMAGE_LOST, NO_PROCESSOR, JobTable
from service.processes import PeriodicThread, StopSignal, log_errors
from service.sandbox import frames
from service.sandbox.client import KILLED, RunningTask, Sandbox, SandboxUnavailableError
from service.settings import Settings
from service.storage.files import Storage, discard, source_key
from service.worker.attempt import PAUSE_AFTER_TROUBLE_S, Attempt, ClaimLostError, Encoded, StoppedError
from service.worker.sweeping import SweepResult, pause_s, sweep

log = logging.getLogger(__name__)

FOLLOW_S = 0.2  # how soon a request to stop is seen
REGISTER_S = 2.0
RETRY_AFTER_S = 5.0  # for a job whose image cannot be read, so that others go first
THREADS_END_S = 1.0  # part of the grace time; a sweep may be cut short anywhere, and unregistering may fail
BEGINS_S = 30.0  # after which the sandbox counts as one that cannot be started
BEGINS_SOON_S = 5.0  # after which this worker no longer reports that it is alive
GIVES_UP_S = 60.0  # after which it ends, for whoever started it to start another


class ImageLostError(Exception):
    """The image of a job is missing from the storage, or cut."""


class Worker:
    """Runs jobs until stopping is requested."""

    def __init__(
        self, settings: Settings, table: JobTable, storage: Storage, sandbox: Sandbox, stop: StopSignal
    ) -> None:
        self._settings = settings
        self._table = table
        self._storage = storage
        self._sandbox = sandbox
        self._stop = stop
        self._name = f"{socket.gethostname()}:{os.getpid()}"
        self._owed_since: float | None = None  # since when the sandbox has begun no task, though it was given some
        self._storage_is_checked = True

    def run(self) -> bool:
        """Claim and work until stopping is requested; sweep meanwhile. False: it gave up, since no job begins."""
        log.info("worker %s: ready, threads: %d", self._name, self._settings.encode_threads)
        settings, stop = self._settings, self._stop
        unregister = functools.partial(self._table.unregister, self._name)
        threads = [
            PeriodicThread("sweeping", self._sweep, pause_s(settings.retention_s, settings.source_retention_s), stop),
            PeriodicThread("reporting", self._register, REGISTER_S, stop, unregister),
        ]
        for thread in threads:
            thread.start()
        while not stop.requested and self._owed_s < GIVES_UP_S:
            idle_s = PAUSE_AFTER_TROUBLE_S
            with log_errors("running a job"):
                idle_s = 0.0 if self.run_one() else self._table.poll_s
            stop.wait(idle_s)
        gave_up = not stop.requested
        if gave_up:
            log.error("worker %s: ends, since no job has begun for %.0f s", self._name, self._owed_s)
            stop.request()
        for thread in threads:
            thread.join(THREADS_END_S)
        return not gave_up

    @property
    def _owed_s(self) -> float:
        """Seconds without a job that began, though some were claimed. One that waits for the database owes nothing."""
        return 0.0 if self._owed_since is None else time.monotonic() - self._owed_since

    def _register(self) -> None:
        if self._owed_s < BEGINS_SOON_S:
            self._table.register(self._name)

    def _sweep(self) -> None:
        settings = self._settings
        swept = sweep(
            self._table, self._storage, retention_s=settings.retention_s, source_retention_s=settings.source_retention_s
        )
        if swept != SweepResult(0, 0):
            log.info("removed %d finished jobs and %d files; %d files stay", swept.jobs, swept.files, swept.stuck)

    def run_one(self) -> bool:
        """Run the next job. Returns False if none waits. Raises JobTableError, OSError."""
        self._fail_lost_jobs()
        if not self._storage_is_checked:  # each claim is an attempt of its job, which would end like the last one
            self._storage.check()
            self._storage_is_checked = True
        claim = self._table.claim(self._name)
        if claim is None:
            self._owed_since = None
            return False
        log.info("job %s: attempt %d of worker %s", claim.id, claim.attempt, self._name)
        attempt = Attempt(self._table, self._storage, claim, self._stop)
        try:
            attempt.conclude(self._encode(attempt))
        except ClaimLostError:
            log.warning("job %s: attempt %d was deleted or taken over", claim.id, claim.attempt)
        except StoppedError:
            log.info("job %s: handed back", claim.id)
            self._table.release(claim)
        except OSError:  # such as a storage out of reach: this must not count against the job
            self._storage_is_checked = False
            self._table.release(claim, RETRY_AFTER_S)
            raise
        attempt.remove_leftovers()
        return True

    def _fail_lost_jobs(self) -> None:
        for job in self._table.reconcile():
            log.warning("job %s failed: its workers were lost %d times", job.id, job.losses)
            if not self._table.keeps_sources:
                discard(self._storage, source_key(job.id))

    def _encode(self, attempt: Attempt) -> Encoded | JobError:
        """Encode in the sandbox; no task is running after that. Raises ClaimLostError, StoppedError, OSError."""
        try:
            with attempt.renewing_lease(functools.partial(self._source, attempt.claim)) as source:
                self._owed_since = self._owed_since or time.monotonic()
                with self._sandbox.start(self._task(attempt.claim), source) as running:
                    return self._follow(running, attempt)
        except ImageLostError:
            return IMAGE_LOST
        except frames.FrameError as error:
            return JobError("crashed", f"the encoder sent an invalid message: {error}")

    def _task(self, claim: Job) -> frames.Encode:
        threads = self._settings.encode_threads
        return frames.Encode(
            job_id=claim.id,
            request=claim,
            threads=threads,
            memory_bytes=self._settings.job_memory_bytes,
            cpu_s=math.ceil(self._settings.job_timeout_s * (threads + 1)),
            max_pixels=claim.image.width * claim.image.height,
        )

    def _source(self, claim: Job) -> BinaryIO:
        """Open the image of a job. Raises ImageLostError, OSError."""
        try:
            source = self._storage.open(source_key(claim.id))
        except FileNotFoundError:
            self._storage.check()  # one that is away has no image either
            raise ImageLostError from None
        if source.seek(0, io.SEEK_END) != claim.image.bytes:
            source.close()
            raise ImageLostError
        return source

    def _follow(self, running: RunningTask, attempt: Attempt) -> Encoded | JobError:
        """Relay progress to the job table until the encode ends or must be ended. Raises StoppedError and others."""
        started = time.monotonic()
        while not self._stop.requested:
            messages = running.read(FOLLOW_S)
            if running.begun:
                self._owed_since = None
            for message in messages:
                if isinstance(message, frames.TracePoint):
                    attempt.add(message.model_dump(exclude={"kind"}))
                else:
                    attempt.beat(now=True)
                    return _end_of(message)
            seconds = time.monotonic() - started
            if not running.begun and seconds > BEGINS_S:
                raise SandboxUnavailableError("the sandbox cannot be started")
            if seconds > self._settings.job_timeout_s:
                return NO_PROCESSOR
            attempt.beat()
        raise StoppedError


def _end_of(message: frames.Message) -> Encoded | JobError:
    """Return the file of the message that ended a task, or why there is none."""
    match message:
        case frames.Result(figures=figures, file=file):
            return Encoded(figures.model_dump(exclude={"notes"}), file, figures.notes)
        case frames.Refused(error="MemoryError"):
            return JobError("refused", "the encode exceeds the memory limit")
        case frames.Refused(detail=detail):
            return JobError("refused", detail)
        case frames.Crashed(detail=how):
            return JobError("crashed", f"the encoder crashed: {how}")
        case frames.Ended(status=status) if status == -signal.SIGPROF:
            return JobError("timed_out", "the encode exceeds the time limit")
        case frames.Ended(status=status) if status == -signal.SIGKILL:
            return JobError("crashed", f"{KILLED}: the encode needs more than there is")
        case frames.Ended(status=status):
            how = f"exit status {status}" if status >= 0 else signal.strsignal(-status) or "an unknown signal"
            return JobError("crashed", f"the encoder crashed ({how})")
        case _:
            raise AssertionError(message)
