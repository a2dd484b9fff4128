"""The job record: request, progress and outcome.

    queued --claim--> running --finish--> done
      ^                  |-----fail-----> failed
      '--crash, release, lease over--'

A claim raises the job's `attempt`, the fencing token: heartbeat, finish, fail and release change the row only while it
is still running at that attempt. A worker that was taken for dead and wakes up again finds its token stale, so a job
may run twice but is never published twice.
"""

from __future__ import annotations

import json
import re
import secrets
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Json, SkipValidation, TypeAdapter

from sgmethod.budget import BudgetKind
from sgmethod.encode_arguments import EncodeOptions

JobState = Literal["queued", "running", "done", "failed"]
JOB_STATES: tuple[JobState, ...] = get_args(JobState)
FINAL_STATES: tuple[JobState, ...] = ("done", "failed")
Priority = Literal["interactive", "bulk"]
JsonObject = Mapping[str, Any]

_JOB_ID = re.compile(r"[0-9a-f]{32}")


def new_job_id() -> str:
    """Return 128 random bits in hexadecimal. They cannot be guessed: without API keys, the id is the only secret."""
    return secrets.token_hex(16)


def is_job_id(text: str) -> bool:
    """Whether a text has the form of an id. No other text reaches the table or the disk."""
    return _JOB_ID.fullmatch(text) is not None


@dataclass(frozen=True, kw_only=True)
class EncodeRequest(EncodeOptions):
    """An encode that a client asks for. A row may have values that only a later version knows."""

    budget_kind: SkipValidation[BudgetKind]
    budget_value: float
    budget_max_bpp: float | None = None
    time_limit_s: float


@dataclass(frozen=True)
class SourceImage:
    """The header of an image; width and height in pixels, size in bytes."""

    format: str
    width: int
    height: int
    size_bytes: int


@dataclass(frozen=True)
class NewJob:
    """A job to insert.

    fingerprint: digest of the client's request, compared when an idempotency key is used again; owner: owner of the API
    key, None without keys; client: of whose jobs not too many may wait, the owner of a key or an address.
    """

    id: str
    request: EncodeRequest
    image: SourceImage
    fingerprint: str
    idempotency_key: str | None = None
    owner: str | None = None
    priority: Priority = "interactive"
    client: str = ""


@dataclass(frozen=True)
class JobError:
    """The reason why a job failed. code: "refused" by the codec, "crashed" or "timed_out"; detail: one sentence."""

    code: str
    detail: str


@dataclass(frozen=True)
class EncodeResult:
    """A finished encode: key of its bitstream, the SHA-256 (hex) of its bytes, and the codec's figures."""

    bitstream_key: str
    sha256: str
    stats: JsonObject

    @property
    def size_bytes(self) -> int:
        return int(self.stats.get("bytes", 0))


@dataclass(frozen=True)
class Job:
    """A row of the table. Times are seconds since 1970 (UTC).

    number: order of acceptance; attempt: the latest, with which its worker claims the job; crashes: attempts that
    crashed; losses: attempts that lost their worker.
    """

    number: int
    id: str
    owner: Annotated[str | None, BeforeValidator(lambda name: name or None)]  # '' in the table
    priority: Priority
    state: JobState
    request: Json[EncodeRequest]
    image: Json[SourceImage]
    attempt: int
    crashes: int
    losses: int
    created_at: float
    started_at: float | None
    finished_at: float | None
    result: Json[EncodeResult] | None
    error: Json[JobError] | None


_jobs = TypeAdapter(Job)


def job_of(row: Any) -> Job:
    """Return a row as a Job. Fields that a later version has added to its JSON are ignored."""
    return _jobs.validate_python(dict(row))


def row_of(job: NewJob) -> tuple[Any, ...]:
    """Return the values of a new row, in the order of statements.INSERT."""
    return (
        *(job.id, job.owner or "", job.client, job.priority, job.idempotency_key, job.fingerprint),
        *(as_json(job.request), as_json(job.image), job.image.size_bytes),
    )


def as_json(value: EncodeRequest | SourceImage | EncodeResult | JobError) -> str:
    """Return a part of a job as its row stores it."""
    return json.dumps(asdict(value))


@dataclass(frozen=True)
class Counts:
    """Counts over the table. Times are in seconds, by the table's own clock.

    jobs: by state; waiting_s: how long the oldest queued job has waited, None if none waits; stored_bytes: of images
    and bitstreams; workers: seconds since each last reported, by name; totals: see tallies.py.
    """

    jobs: Mapping[JobState, int]
    waiting_s: float | None
    stored_bytes: int
    workers: Mapping[str, float]
    totals: Mapping[str, float]

    @property
    def silent_s(self) -> float | None:
        """Seconds since any worker reported, None if none is known."""
        return min(self.workers.values(), default=None)
