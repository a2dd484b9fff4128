"""What a job table is told and what it says, whichever database it is in.

    queued --claim--> running --finish--> done
      ^                  |-----fail-----> failed
      '--crash, release, lease over--'

A claim raises the job's `attempt`, the fencing token: heartbeat, finish, fail and release change the row
only while it is still running at that attempt. A worker that was taken for dead and wakes up again finds
its token stale, so a job may run twice but is never published twice.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from service.jobs.job import EncodeRequest, JobState


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
class SubmitLimits:
    """How many jobs, and bytes, a new job must not exceed; 0 for any number.

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
    source_retention_s: for how long the image of a finished job is kept; webhooks: addresses that are told when a job
    ends.
    """

    lease_s: float
    max_attempts: int
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
    """The table at a glance. Seconds are by the table's own clock.

    jobs: how many are in each state; waiting_s: age of the oldest queued job, None if none waits; stored_bytes: of
    images and bitstreams; workers: seconds since the last sign of life of each, by name; failures: of the background
    work of each; notices: webhooks to be delivered; notice_waits_s: age of the oldest of them; totals: of totals.py.
    """

    jobs: Mapping[JobState, int]
    waiting_s: float | None
    stored_bytes: int
    workers: Mapping[str, float] = field(default_factory=dict)
    failures: Mapping[str, int] = field(default_factory=dict)
    notices: int = 0
    notice_waits_s: float = 0.0
    totals: Mapping[str, float] = field(default_factory=dict)

    @property
    def silent_s(self) -> float | None:
        """Seconds since any worker was last heard from, None if none is known."""
        return min(self.workers.values(), default=None)
