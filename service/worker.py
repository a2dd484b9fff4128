"""A worker: claims one job at a time, has it encoded in a child process, publishes the result."""

from __future__ import annotations

import hashlib
import logging
import os
import socket
import sys
import time
from dataclasses import dataclass

from service.encode_child import Spec
from service.encode_process import Encoded, EncodeProcess, Refused, TracePoint
from service.jobs import (
    FINAL_STATES,
    BackendError,
    Claim,
    EncodeResult,
    JobBackend,
    JobError,
    JsonObject,
)
from service.lifeline import Lifeline
from service.settings import Settings
from service.stopping import StopSignal
from service.storage import Storage, bitstream_key, source_key

log = logging.getLogger(__name__)

FOLLOW_S = 0.2  # how soon a wish to stop is seen
HEARTBEAT_S = 0.5  # how fresh the progress is that a client sees
PAUSE_AFTER_TROUBLE_S = 1.0
FINISH_TRIES = 5
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

    def __init__(self, backend: JobBackend, claim: Claim, lease_s: float) -> None:
        self._backend = backend
        self._claim = claim
        self._lease_s = lease_s
        self._points: list[JsonObject] = []
        self._sent = 0
        self._last = time.monotonic()

    def add(self, point: JsonObject) -> None:
        """Note a trace point for the next beat."""
        self._points.append(point)

    def beat(self, *, now: bool = False) -> None:
        """Renew the lease if it is time to, or now. Raises ClaimLostError."""
        silence = time.monotonic() - self._last
        if silence < HEARTBEAT_S and not now:
            return
        try:
            alive = self._backend.heartbeat(self._claim, self._points, self._sent)
        except BackendError as error:
            log.warning("job %s: no heartbeat for %.1f s: %s", self._claim.job_id, silence, error)
            if silence > self._lease_s:
                raise ClaimLostError from error
            return
        if not alive:
            raise ClaimLostError
        self._last = time.monotonic()
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
        # Libraries read these when they are loaded, so they must stand before the child begins.
        threads = str(settings.encode_threads)
        self._environment = {**os.environ, **dict.fromkeys(THREAD_VARIABLES, threads)}

    def run(self) -> None:
        """Claim and work until stopping is requested."""
        log.info("worker %s: ready, %d threads", self._name, self._settings.encode_threads)
        self._backend.deliver(self._run_next, self._stop)
        self._lifeline.close()

    def _run_next(self) -> bool:
        """Like run_one, but trouble with table or disk is logged and waited out."""
        try:
            return self.run_one()
        except (BackendError, OSError):
            log.exception("worker %s: trouble", self._name)
            self._stop.wait(PAUSE_AFTER_TROUBLE_S)
            return False

    def run_one(self) -> bool:
        """Run the next job if there is one; False if none waits. Raises BackendError, OSError."""
        for job in self._backend.reconcile():
            log.warning("job %s failed: its workers were lost %d times", job.id, job.crashes + 1)
            self._storage.delete(source_key(job.id))
        claim = self._backend.claim(self._name)
        if claim is None:
            return False
        log.info("job %s: attempt %d", claim.job_id, claim.attempt)
        try:
            self._conclude(claim, self._encode(claim))
        except ClaimLostError:
            log.warning("job %s: attempt %d is no longer ours", claim.job_id, claim.attempt)
        except StoppedError:
            log.info("job %s: handed back", claim.job_id)
            self._backend.release(claim)
        self._tidy(claim)
        return True

    def _encode(self, claim: Claim) -> Outcome:
        """Have the child encode. Raises ClaimLostError, StoppedError; the child is dead when this returns."""
        spec = Spec(
            claim.job_id,
            claim.attempt,
            claim.request,
            self._lifeline.read_end,
            self._settings.job_memory_bytes,
        )
        command = [sys.executable, "-m", "service.encode_child", spec.to_json()]
        try:
            source = self._storage.open(source_key(claim.job_id))
        except FileNotFoundError:
            return Crashed("the source image is gone")
        with source, EncodeProcess(command, source, self._environment, spec.lifeline) as child:
            try:
                return self._follow(child, Pulse(self._backend, claim, self._settings.lease_s))
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

    def _conclude(self, claim: Claim, outcome: Outcome) -> None:
        """Write the outcome down. Raises ClaimLostError, BackendError, OSError."""
        match outcome:
            case Encoded():
                self._publish(claim, outcome)
                return
            case Refused(detail):
                error, retry = JobError("refused", detail), False
            case Crashed(detail):
                error, retry = JobError("crashed", detail), True
            case TimedOut():
                detail = f"the encode took longer than {self._settings.job_timeout_s:g} s"
                error, retry = JobError("timed_out", detail), False
        log.warning("job %s: attempt %d %s: %s", claim.job_id, claim.attempt, error.code, error.detail)
        if not self._backend.fail(claim, error, retry=retry):
            raise ClaimLostError

    def _publish(self, claim: Claim, encoded: Encoded) -> None:
        """Store the bitstream, then make it the job's in one update."""
        key = bitstream_key(claim.job_id, claim.attempt)
        self._storage.put(key, encoded.bitstream)
        result = EncodeResult(key, hashlib.sha256(encoded.bitstream).hexdigest(), encoded.stats)
        if not self._finish(claim, result):
            self._storage.delete(key)
            raise ClaimLostError
        log.info("job %s: done, %d bytes", claim.job_id, len(encoded.bitstream))

    def _finish(self, claim: Claim, result: EncodeResult) -> bool:
        for _ in range(FINISH_TRIES - 1):
            try:
                return self._backend.finish(claim, result)
            except BackendError as error:
                log.warning("job %s: cannot publish yet: %s", claim.job_id, error)
                time.sleep(PAUSE_AFTER_TROUBLE_S)
        return self._backend.finish(claim, result)

    def _tidy(self, claim: Claim) -> None:
        """Remove the source image of a job that will not run again."""
        job = self._backend.get(claim.job_id)
        if job is None or job.state in FINAL_STATES:
            self._storage.delete(source_key(claim.job_id))
