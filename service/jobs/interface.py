"""What a job is, and what a queue of jobs must do, whatever stores it.

    queued --claim--> running --finish--> done
      ^                  |-----fail-----> failed
      '--crash, release, lease over--'

A claim raises the job's `attempt`, the fencing token: heartbeat, finish, fail and release change the row
only while it is still running at that attempt. A worker that was taken for dead and wakes up again finds
its token stale, so a job may run twice but is never published twice.
"""

from __future__ import annotations

import re
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from service.process.stopping import StopSignal
from sgmethod.budget import BudgetKind

JobState = Literal["queued", "running", "done", "failed"]
JOB_STATES: tuple[JobState, ...] = ("queued", "running", "done", "failed")
FINAL_STATES: tuple[JobState, ...] = ("done", "failed")
Priority = Literal["interactive", "bulk"]
PRIORITIES: tuple[Priority, ...] = ("interactive", "bulk")
JsonObject = Mapping[str, Any]

_JOB_ID = re.compile(r"[0-9a-f]{32}")


def new_job_id() -> str:
    """128 random bits: who holds an id may read the job, so ids cannot be guessed."""
    return secrets.token_hex(16)


def is_job_id(text: str) -> bool:
    """Whether text has the form of an id; nothing else ever reaches the table or the disk."""
    return _JOB_ID.fullmatch(text) is not None


class BackendError(Exception):
    """The job table cannot be read or written just now; trying again later may succeed."""


class QueueFullError(Exception):
    """As many jobs wait as the settings allow."""


class OwnQueueFullError(QueueFullError):
    """As many jobs of this owner wait as the settings allow one owner."""


class KeyReusedError(Exception):
    """An idempotency key came again with another request."""


@dataclass(frozen=True)
class JobRules:
    """What holds for all jobs.

    lease_s: seconds until a silent worker's job goes back; max_attempts: crashes that make a job fail;
    max_running_per_owner: jobs of one owner that run at once, 0 for any number.
    """

    lease_s: float
    max_attempts: int
    max_running_per_owner: int = 0


@dataclass(frozen=True)
class EncodeRequest:
    """What the client asked for; the names are sgmethod's."""

    budget_kind: BudgetKind
    budget_value: float
    profile: str
    time_limit_s: float


@dataclass(frozen=True)
class SourceImage:
    """What the image's header says; width and height in pixels, size in bytes."""

    format: str
    width: int
    height: int
    size_bytes: int


@dataclass(frozen=True)
class NewJob:
    """A job to accept.

    fingerprint: digest of the whole request, compared when an idempotency key comes again; owner: whose
    API key came with the request, None where there are no keys.
    """

    id: str
    request: EncodeRequest
    image: SourceImage
    fingerprint: str
    idempotency_key: str | None = None
    owner: str | None = None
    priority: Priority = "interactive"


@dataclass(frozen=True)
class JobError:
    """Why a job failed. code: "refused" by the codec, "crashed" or "timed_out"; detail: one sentence."""

    code: str
    detail: str


@dataclass(frozen=True)
class EncodeResult:
    """A finished encode: where its bitstream lies, the bytes' SHA-256 (hex) and the codec's figures."""

    bitstream_key: str
    sha256: str
    stats: JsonObject


@dataclass(frozen=True)
class Claim:
    """The right of one worker to run a job, until its lease is over. attempt is the fencing token."""

    job_id: str
    attempt: int
    request: EncodeRequest


@dataclass(frozen=True)
class Job:
    """A row of the table. Times are seconds since 1970 (UTC).

    number: place in the order of acceptance; position: place in the queue from 1 if owners did not take
    turns, None unless queued; crashes: attempts that ended without a word, which is what the limit of
    attempts counts.
    """

    number: int
    id: str
    owner: str | None
    priority: Priority
    state: JobState
    position: int | None
    request: EncodeRequest
    image: SourceImage
    attempt: int
    crashes: int
    created_at: float
    started_at: float | None
    finished_at: float | None
    result: EncodeResult | None
    error: JobError | None


@dataclass(frozen=True)
class Census:
    """The table at a glance.

    jobs: how many are in each state; waiting_s: age of the oldest queued job, None if none waits; silent_s: since
    any worker was last heard from, None if none ever was. Seconds, by the table's own clock.
    """

    jobs: Mapping[JobState, int]
    waiting_s: float | None
    silent_s: float | None


class JobBackend(Protocol):
    """A durable queue of jobs. Every method may raise BackendError; all are safe to call from any
    thread. What a method has returned has reached the disk."""

    def submit(self, job: NewJob, queue_length: int, own_queue_length: int = 0) -> tuple[Job, bool]:
        """Accept a job; returns it and True, or its owner's job that came first under the same key and False.

        Raises QueueFullError if queue_length jobs wait already, OwnQueueFullError if own_queue_length of
        the same owner do (0 for any number), KeyReusedError if the key stands for another request.
        """
        ...

    def find_key(self, idempotency_key: str, owner: str | None = None) -> Job | None:
        """The owner's job that was accepted under the key; each owner has keys of their own."""
        ...

    def queued(self, owner: str | None = None) -> int:
        """How many jobs wait; with an owner, how many of theirs."""
        ...

    def census(self) -> Census:
        """How many jobs there are in each state, and how long the queue has waited."""
        ...

    def get(self, job_id: str, owner: str | None = None) -> Job | None:
        """The job, or None if there is none of that id; with an owner, only if it is theirs."""
        ...

    def page(self, limit: int, before: int | None = None, owner: str | None = None) -> list[Job]:
        """The newest jobs, newest first, of those with a number below `before`; with an owner, only theirs."""
        ...

    def trace(self, job_id: str, first: int = 0) -> list[JsonObject]:
        """The trace points of the job's latest attempt, oldest first, without so many at the beginning."""
        ...

    def remove(self, job_id: str) -> Job | None:
        """Forget a job in whatever state, and return it. A worker that runs it loses its claim."""
        ...

    def reconcile(self) -> list[Job]:
        """Put running jobs whose worker is lost back into the queue; those that crashed too often fail.

        A worker is lost when it has not renewed its lease in time, and this table object has watched it not do so
        for a while: call this every now and then. Returns the jobs that failed.
        """
        ...

    def claim(self, worker: str) -> Claim | None:
        """Take the next queued job for a worker (a name for operators), or None if none may run.

        Interactive jobs come before bulk ones; among equals the owner with the fewest running jobs, then
        the owner served longest ago, then the oldest job. An owner at the limit of running jobs waits.
        """
        ...

    def heartbeat(self, claim: Claim, points: Sequence[JsonObject], first: int) -> bool:
        """Renew the lease and append trace points, `first` being the index of the first of them.

        False: the job is no longer this worker's.
        """
        ...

    def finish(self, claim: Claim, result: EncodeResult) -> bool:
        """Publish the result. Repeating the call is safe. False: the job is no longer this worker's."""
        ...

    def fail(self, claim: Claim, error: JobError, *, retry: bool) -> bool:
        """End an attempt in failure: with retry as a crash, of which a job may have a few, else for good.

        False: the job is no longer this worker's.
        """
        ...

    def release(self, claim: Claim) -> bool:
        """Hand the job back unharmed, at its old place in the queue. False: it was no longer ours."""
        ...

    def deliver(self, run_next: Callable[[], bool], stop: StopSignal) -> None:
        """Call run_next, in one thread at a time, whenever there may be a job to claim; return when stop says so.

        run_next tells whether it ran a job, and never raises.
        """
        ...

    def live_keys(self) -> set[str]:
        """Storage keys that some job still needs."""
        ...

    def finished(self, older_than_s: float) -> list[Job]:
        """The jobs that have been done or failed for longer than that (seconds)."""
        ...

    def close(self) -> None:
        """Let go of connections."""
        ...
