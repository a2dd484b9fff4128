"""What a job is: what was asked for, how far it is, how it ended."""

from __future__ import annotations

import json
import re
import secrets
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Json, TypeAdapter

from sgmethod.budget import BudgetKind
from sgmethod.profiles import DEFAULT_EFFORT, Tune

JobState = Literal["queued", "running", "done", "failed"]
JOB_STATES: tuple[JobState, ...] = ("queued", "running", "done", "failed")
FINAL_STATES: tuple[JobState, ...] = ("done", "failed")
Priority = Literal["interactive", "bulk"]
PRIORITIES: tuple[Priority, ...] = ("interactive", "bulk")
JsonObject = Mapping[str, Any]

_JOB_ID = re.compile(r"[0-9a-f]{32}")


def new_job_id() -> str:
    """128 random bits: anyone with the id may read the job, so ids cannot be guessed."""
    return secrets.token_hex(16)


def is_job_id(text: str) -> bool:
    """Whether text has the form of an id; nothing else ever reaches the table or the disk."""
    return _JOB_ID.fullmatch(text) is not None


@dataclass(frozen=True)
class EncodeRequest:
    """What the client asked for; the names are sgmethod's."""

    budget_kind: BudgetKind
    budget_value: float
    profile: str
    time_limit_s: float
    tune: Tune = "psnr"
    effort: int = DEFAULT_EFFORT


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

    @property
    def size_bytes(self) -> int:
        """The bitstream's size."""
        return int(self.stats.get("bytes", 0))


@dataclass(frozen=True)
class Job:
    """A row of the table. Times are seconds since 1970 (UTC).

    number: place in the order of acceptance; position: place in the queue from 1 if owners did not take
    turns, None unless queued; crashes: attempts that crashed or lost their worker, which is what the
    limit of attempts counts; stored_bytes: of the image and the bitstream, as far as they are kept;
    stopped: whether the attempt that runs is to end early, with what it has.
    """

    number: int
    id: str
    owner: Annotated[str | None, BeforeValidator(lambda name: name or None)]  # '' in the table
    priority: Priority
    state: JobState
    position: int | None
    request: Json[EncodeRequest]
    image: Json[SourceImage]
    attempt: int
    crashes: int
    created_at: float
    started_at: float | None
    finished_at: float | None
    result: Json[EncodeResult] | None
    error: Json[JobError] | None
    stored_bytes: int
    stopped: bool = False


_jobs = TypeAdapter(Job)


def job_of(row: Any) -> Job:
    """A row with its position. What a later version of this service has added to its JSON is left out."""
    return _jobs.validate_python(dict(row))


def as_json(value: EncodeRequest | SourceImage | EncodeResult | JobError) -> str:
    """A part of a job as its row has it."""
    return json.dumps(asdict(value))
