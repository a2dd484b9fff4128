"""What a job table must do, whichever database it is in.

    queued --claim--> running --finish--> done
      ^                  |-----fail-----> failed
      '--crash, release, lease over--'

A claim raises the job's `attempt`, the fencing token: heartbeat, finish, fail and release change the row
only while it is still running at that attempt. A worker that was taken for dead and wakes up again finds
its token stale, so a job may run twice but is never published twice.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from service.jobs.job import EncodeRequest, EncodeResult, Job, JobError, JobState, JsonObject, NewJob
from service.jobs.notices import Notice
from service.process.stopping import StopSignal


class JobTableError(Exception):
    """The job table cannot be read or written just now; trying again later may succeed."""


class QueueFullError(Exception):
    """As many jobs wait as the settings allow."""


class OwnQueueFullError(QueueFullError):
    """As many jobs of this owner wait as the settings allow one owner."""


class QuotaError(Exception):
    """What is stored leaves no room for the job. of_owner: whether it is the owner's quota, or everybody's."""

    def __init__(self, of_owner: bool) -> None:
        super().__init__()
        self.of_owner = of_owner


class KeyReusedError(Exception):
    """An idempotency key came again with another request."""


@dataclass(frozen=True)
class Room:
    """How much there is for new jobs; 0 for any number.

    queue_length, own_queue_length: jobs waiting, of all and of one owner; quota, own_quota: the same for bytes stored.
    """

    queue_length: int
    own_queue_length: int = 0
    quota: int = 0
    own_quota: int = 0


@dataclass(frozen=True)
class JobRules:
    """What holds for all jobs.

    lease_s: seconds until a silent worker's job goes back; max_attempts: crashes that make a job fail;
    max_running_per_owner: jobs of one owner that run at once, 0 for any number; source_retention_s: for how long the
    image of a finished job is kept; webhooks: addresses that are told when a job ends.
    """

    lease_s: float
    max_attempts: int
    max_running_per_owner: int = 0
    source_retention_s: float = 0.0
    webhooks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Claim:
    """The right of one worker to run a job, until its lease is over. attempt is the fencing token."""

    job_id: str
    attempt: int
    request: EncodeRequest


@dataclass(frozen=True)
class Census:
    """The table at a glance.

    jobs: how many are in each state; waiting_s: age of the oldest queued job, None if none waits; silent_s: since
    any worker was last heard from, None if none ever was. Seconds, by the table's own clock. stored_bytes: of images
    and bitstreams; workers: seconds since the last sign of life of each, by name; notices: webhooks to be delivered;
    notice_waits_s: age of the oldest of them.
    """

    jobs: Mapping[JobState, int]
    waiting_s: float | None
    silent_s: float | None
    stored_bytes: int
    workers: Mapping[str, float] = field(default_factory=dict)
    notices: int = 0
    notice_waits_s: float = 0.0


class JobTable(Protocol):
    """All jobs. Every method may raise JobTableError, and may be called from any thread.

    What a method has done is on the disk when it returns.
    """

    def submit(self, job: NewJob, room: Room) -> tuple[Job, bool]:
        """Accept a job; returns it and True, or its owner's job that came first under the same key and False.

        Raises QueueFullError, OwnQueueFullError or QuotaError if there is no room for it, KeyReusedError if the key
        stands for another request.
        """
        ...

    def find_by_key(self, idempotency_key: str, owner: str | None = None) -> Job | None:
        """The owner's job that was accepted under the key; each owner has keys of their own."""
        ...

    def stored_bytes(self, owner: str | None = None) -> int:
        """Bytes of images and bitstreams that are kept; with an owner, of theirs."""
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

    def page(
        self, limit: int, before: int | None = None, owner: str | None = None, state: JobState | None = None
    ) -> list[Job]:
        """The newest jobs, newest first, of those with a number below `before`; with an owner, only theirs; with a
        state, only those in it.
        """
        ...

    def trace(self, job_id: str, first: int = 0) -> list[JsonObject]:
        """The trace points of the job's latest attempt, oldest first, without the first `first`."""
        ...

    def remove(self, job_id: str) -> Job | None:
        """Forget a job in whatever state, and return it. A worker that runs it loses its claim."""
        ...

    def reconcile(self) -> list[Job]:
        """Put running jobs whose worker is lost back into the queue; those that crashed too often fail.

        A worker is lost when it has not renewed its lease in time, and this object has watched it fail to for a while
        longer. So call this again and again. Returns the jobs that failed.
        """
        ...

    def claim(self, worker: str) -> Claim | None:
        """Take the next queued job for a worker (a name for operators), or None if none may run.

        Interactive jobs come before bulk ones; among equals the owner with the fewest running jobs, then
        the owner served longest ago, then the oldest job. An owner at the limit of running jobs waits.
        """
        ...

    def sign(self, worker: str) -> None:
        """The worker lives, whether or not it has a job."""
        ...

    def sign_off(self, worker: str) -> None:
        """The worker has stopped on request."""
        ...

    def heartbeat(self, claim: Claim, points: Sequence[JsonObject], first: int) -> bool:
        """Renew the lease and append trace points, `first` being the index of the first of them.

        False: the job is no longer this worker's.
        """
        ...

    def stop(self, job_id: str) -> bool:
        """Ask the worker of a running job to end the fit early and publish what there is; a later attempt at the job
        knows nothing of it. False: the job is not running.
        """
        ...

    def stop_wanted(self, claim: Claim) -> bool:
        """Whether this attempt is asked to end early."""
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
        """Hand the job back, at its old place in the queue; no crash is counted. False: it is no longer ours."""
        ...

    def deliver(self, run_next: Callable[[], bool], stop: StopSignal) -> None:
        """Call run_next, in one thread at a time, whenever there may be a job to claim; return when stopping is
        requested.

        run_next tells whether it ran a job, and never raises.
        """
        ...

    def needed_keys(self) -> set[str]:
        """Storage keys of the files that some job still needs."""
        ...

    def source_removed(self, job_id: str) -> None:
        """The image of a finished job is gone, and counts no longer among the bytes that are stored."""
        ...

    def finished(self, older_than_s: float, owner: str | None = None) -> list[Job]:
        """The jobs, oldest first, that were done or failed for longer than that (seconds); with an owner, theirs."""
        ...

    def due_notice(self, address: str) -> Notice | None:
        """A notice that a job has ended, for the caller to send now; unless it is said to be delivered, it is due again
        after a pause, which doubles. Those of more than three days ago are given up.
        """
        ...

    def notice_delivered(self, notice: Notice) -> None:
        """The address has taken it."""
        ...

    def close(self) -> None:
        """Let go of connections."""
        ...
