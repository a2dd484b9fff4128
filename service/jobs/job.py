"""The job: what was asked, how far it is, and what came of it. Its row and its JSON have the same members.

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
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, Field, PlainSerializer

JobState = Literal["queued", "running", "done", "failed"]
JOB_STATES: tuple[JobState, ...] = get_args(JobState)
FINAL_STATES: tuple[JobState, ...] = ("done", "failed")
Priority = Literal["interactive", "bulk"]
JsonObject = Mapping[str, Any]
Figure = float | int | str | None
# Seconds since 1970, in JSON a date.
Time = Annotated[float, PlainSerializer(lambda seconds: datetime.fromtimestamp(seconds, UTC), return_type=datetime)]
Id = Annotated[
    str, Field(description="32 hexadecimal digits; without API keys, anyone who knows the id can read the job")
]

_JOB_ID = re.compile(r"[0-9a-f]{32}")


def new_job_id() -> str:
    """Return 128 random bits in hexadecimal. They cannot be guessed: without API keys, the id is the only secret."""
    return secrets.token_hex(16)


def is_job_id(text: str) -> bool:
    """Whether a text has the form of an id. No other text reaches the table or the disk."""
    return _JOB_ID.fullmatch(text) is not None


class BudgetView(BaseModel):
    """The budget of an encode."""

    kind: str = Field(description='"bpp", "bytes", "quality", "psnr" or "gaussians"')
    value: float
    max_bpp: float | None = Field(description="limit in bits per pixel beside the default quality, else null")


class ImageView(BaseModel):
    """The source image, from its header."""

    format: str
    width: int = Field(description="pixels")
    height: int = Field(description="pixels")
    bytes: int


class EncodeRequest(BaseModel):
    """An encode that a client asks for. A row may have values that only a later version knows."""

    budget: BudgetView
    profile: str
    tune: str = Field(description='"psnr", "fidelity" or "visual"')
    effort: int = Field(description="1 (fastest) to 9 (best file)")
    time_limit_s: float


@dataclass(frozen=True)
class NewJob:
    """A job to insert.

    fingerprint: digest of the client's request, compared when an idempotency key is used again; owner: owner of the API
    key, None without keys; client: of whose jobs not too many may wait, the owner of a key or an address.
    """

    id: str
    request: EncodeRequest
    image: ImageView
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
    """A finished encode: the SHA-256 (hex) of the bitstream, the codec's figures, and what it dropped of the image."""

    sha256: str
    result: JsonObject
    notes: Sequence[str] = ()

    @property
    def size_bytes(self) -> int:
        return int(self.result.get("bytes", 0))


class Job(EncodeRequest):
    """A job, as clients see it and as its row has it.

    Hidden from clients: number, the order of acceptance; crashes and losses, attempts that crashed and that lost their
    worker; sha256, of the bitstream.
    """

    id: Id
    state: JobState
    priority: Priority
    image: ImageView
    attempt: int = Field(description="number of times the job has been started")
    created_at: Time
    started_at: Time | None = Field(description="start of the latest attempt")
    finished_at: Time | None
    result: dict[str, Figure | list[str]] | None = Field(
        description="figures of the finished file; warnings has one sentence each for a missed target, a file larger "
        "than its source, a file without Gaussians, and a time limit that cut the encode short on a busy machine; "
        "advice and better name a format that suits the image better"
    )
    notes: list[str] = Field(description="what was dropped from the image, once done")
    error: JobError | None = Field(description="once failed")

    number: int = Field(exclude=True)
    crashes: int = Field(exclude=True)
    losses: int = Field(exclude=True)
    sha256: str = Field(exclude=True)


def job_of(row: Any) -> Job:
    """Return a row as a Job. Fields that a later version has added to its JSON are ignored."""
    columns = dict(row)
    parts = {name: json.loads(columns.pop(name) or "null") for name in ("request", "image", "result", "error")}
    result = parts.pop("result") or {"result": None, "notes": [], "sha256": ""}
    if columns["state"] != "failed":
        parts["error"] = None  # a queued job has that of its last crash, which clients do not need
    return Job.model_validate({**parts.pop("request"), **columns, **parts, **result})


def row_of(job: NewJob) -> tuple[Any, ...]:
    """Return the values of a new row, in the order of statements.INSERT."""
    return (
        *(job.id, job.owner or "", job.client, job.priority, job.idempotency_key, job.fingerprint),
        *(job.request.model_dump_json(), job.image.model_dump_json(), job.image.bytes),
    )


def as_json(value: EncodeResult | JobError) -> str:
    """Return how an attempt ended, as its row stores it."""
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
