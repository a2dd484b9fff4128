"""A worker: claims one job at a time, has it encoded in a child process, publishes the result."""

from __future__ import annotations

import hashlib
import logging
import os
import socket
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

from service.jobs.interface import (
    FINAL_STATES,
    BackendError,
    Claim,
    EncodeResult,
    JobBackend,
    JobError,
    JsonObject,
)
from service.process.lifeline import Lifeline
from service.process.stopping import StopSignal
from service.settings import Settings
from service.storage.disk import Storage, bitstream_key, source_key
from service.worker.encode_child import Spec
from service.worker.encode_process import Encoded, EncodeProcess, Refused, TracePoint
from service.worker.sweeping import Swept, sweep

log = logging.getLogger(__name__)

FOLLOW_S = 0.2  # how soon a wish to stop is seen
HEARTBEAT_S = 0.5  # how fresh the progress is that a client sees
PAUSE_AFTER_TROUBLE_S = 1.0
SWEEP_EVERY_S = 3600.0
THREAD_VARIABLES = ("SG_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


class ClaimLostError(Exception):
    """The job was cancelled, or is another worker's by now."""


class StoppedError(Exception):
    """This worker is to stop."""


@dataclass(frozen=True)
class Crashed:
    """The encoding process ended without a verdict."""

    detail: str


@dataclass(frozen=True)
class TimedOut:
    """The encoding process ran for longer than the settings allow."""


Outcome = Encoded | Refused | Crashed | TimedOut


class Pulse:
    """The heartbeat of one claim; carries the trace along."""

    def __init__(self, backend: JobBackend, claim: Claim) -> None:
        self._backend = backend
        self._claim = claim
        self._points: list[JsonObject] = []
        self._sent = 0
        self._heard = time.monotonic()
        self._next = self._heard + HEARTBEAT_S

    def add(self, point: JsonObject) -> None:
        """Note a trace point for the next beat."""
        self._points.append(point)

    def beat(self, *, now: bool = False) -> None:
        """Renew the lease if it is time to, or now. Raises ClaimLostError.

        However long the table is out of reach, the encode goes on: nobody else may have noticed, and if another
        worker has, the table will say so.
        """
        if time.monotonic() < self._next and not now:
            return
        try:
            alive = self._backend.heartbeat(self._claim, self._points, self._sent)
        except BackendError as error:
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


class Worker:
    """Runs jobs until stopping is requested."""

    def __init__(self, settings: Settings, backend: JobBackend, storage: Storage, stop: StopSignal) -> None:
        self._settings = settings
        self._backend = backend
        self._storage = storage
        self._stop = stop
        self._name = f"{socket.gethostname()}:{os.getpid()}"
        self._lifeline = Lifeline()
        self._next_sweep = 0.0
        # Libraries read these when they are loaded, so they must stand before the child begins.
        threads = str(settings.encode_threads)
        self._environment = {**os.environ, **dict.fromkeys(THREAD_VARIABLES, threads)}

    def run(self) -> None:
        """Claim and work until stopping is requested."""
        log.info("worker %s: ready, %d threads", self._name, self._settings.encode_threads)
        self._backend.deliver(self._run_next, self._stop)
        self._lifeline.close()

    def _run_next(self) -> bool:
        """Like run_one, but trouble with table or storage is logged and waited out."""
        try:
            self._sweep_now_and_then()
            return self.run_one()
        except (BackendError, OSError) as error:
            log.error("worker %s: %s", self._name, error)
            self._stop.wait(PAUSE_AFTER_TROUBLE_S)
            return False

    def _sweep_now_and_then(self) -> None:
        if time.monotonic() < self._next_sweep:
            return
        self._next_sweep = time.monotonic() + SWEEP_EVERY_S
        swept = sweep(self._backend, self._storage, retention_s=self._settings.retention_s)
        if swept != Swept(0, 0):
            log.info("removed %d finished jobs and %d files that no job needs", swept.jobs, swept.files)

    def run_one(self) -> bool:
        """Run the next job if there is one; False if none waits. Raises BackendError, OSError."""
        for job in self._backend.reconcile():
            log.warning("job %s failed: its workers were lost %d times", job.id, job.crashes)
            self._storage.delete(source_key(job.id))
        claim = self._backend.claim(self._name)
        if claim is None:
            return False
        log.info("job %s: attempt %d", claim.job_id, claim.attempt)
        pulse = Pulse(self._backend, claim)
        try:
            self._conclude(claim, self._encode(claim, pulse), pulse)
        except ClaimLostError:
            log.warning("job %s: attempt %d is no longer ours", claim.job_id, claim.attempt)
        except StoppedError:
            log.info("job %s: handed back", claim.job_id)
            self._backend.release(claim)
        except OSError:  # trouble of ours, such as a storage out of reach: it must not count against the job
            self._backend.release(claim)
            raise
        self._tidy(claim)
        return True

    def _encode(self, claim: Claim, pulse: Pulse) -> Outcome:
        """Have the child encode; it is dead when this returns. Raises ClaimLostError, StoppedError, OSError."""
        spec = Spec(
            claim.job_id,
            claim.attempt,
            claim.request,
            self._lifeline.read_end,
            self._settings.job_memory_bytes,
        )
        command = [sys.executable, "-m", "service.worker.encode_child", spec.to_json()]
        try:
            source = self._storage.open(source_key(claim.job_id))
        except FileNotFoundError:
            return Crashed("the source image is gone")
        with source, EncodeProcess(command, source, self._environment, spec.lifeline) as child:
            try:
                return self._follow(child, pulse)
            except ValueError as error:
                return Crashed(f"the encoder spoke nonsense: {error}")

    def _follow(self, child: EncodeProcess, pulse: Pulse) -> Outcome:
        """Relay the child's progress until it reaches a verdict, dies, or must be ended."""
        started = time.monotonic()
        while not self._stop.requested:
            for message in child.read(FOLLOW_S):
                if isinstance(message, TracePoint):
                    pulse.add(message.point)
                    continue
                pulse.beat(now=True)
                return message
            if child.ended:
                return Crashed(child.last_words())
            if time.monotonic() - started > self._settings.job_timeout_s:
                return TimedOut()
            pulse.beat()
        raise StoppedError

    def _conclude(self, claim: Claim, outcome: Outcome, pulse: Pulse) -> None:
        """Write the outcome down. Raises ClaimLostError, StoppedError, BackendError."""
        match outcome:
            case Encoded():
                self._publish(claim, outcome, pulse)
                return
            case Refused(detail):
                error, retry = JobError("refused", detail), False
            case Crashed(detail):
                error, retry = JobError("crashed", detail), True
            case TimedOut():
                detail = f"the encode took longer than {self._settings.job_timeout_s:g} s"
                error, retry = JobError("timed_out", detail), False
        log.warning("job %s: attempt %d %s: %s", claim.job_id, claim.attempt, error.code, error.detail)
        if not self._insist(claim, lambda: self._backend.fail(claim, error, retry=retry)):
            raise ClaimLostError

    def _publish(self, claim: Claim, encoded: Encoded, pulse: Pulse) -> None:
        """Store the bitstream, then make it the job's in one update."""
        key = bitstream_key(claim.job_id, claim.attempt)
        self._store(key, encoded.bitstream, pulse)
        result = EncodeResult(key, hashlib.sha256(encoded.bitstream).hexdigest(), encoded.stats)
        if not self._insist(claim, lambda: self._backend.finish(claim, result)):
            self._storage.delete(key)
            raise ClaimLostError
        log.info("job %s: done, %d bytes", claim.job_id, len(encoded.bitstream))

    def _store(self, key: str, data: bytes, pulse: Pulse) -> None:
        """Store what took long to compute, however long the disk stays full. Raises ClaimLostError, StoppedError."""
        while True:
            try:
                self._storage.put(key, data)
                return
            except OSError as error:
                log.warning("%s cannot be stored yet: %s", key, error)
            if self._stop.wait(PAUSE_AFTER_TROUBLE_S):
                raise StoppedError
            pulse.beat()

    def _insist(self, claim: Claim, last_word: Callable[[], bool]) -> bool:
        """Write the end down, however long the table is out of reach. Raises BackendError if this worker is to stop."""
        while True:
            try:
                return last_word()
            except BackendError as error:
                log.warning("job %s: its end cannot be written down yet: %s", claim.job_id, error)
                if self._stop.wait(PAUSE_AFTER_TROUBLE_S):
                    raise

    def _tidy(self, claim: Claim) -> None:
        """Remove the source image of a job that will not run again."""
        job = self._backend.get(claim.job_id)
        if job is None or job.state in FINAL_STATES:
            self._storage.delete(source_key(claim.job_id))
