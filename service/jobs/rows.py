"""Rows of the job table: a job from one, and sums over many."""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from typing import Any, TypeVar

from service.jobs.job import EncodeRequest, EncodeResult, Job, JobError, NewJob, SourceImage
from service.jobs.statements import Database
from service.jobs.table import OwnQueueFullError, QueueFullError, QuotaError, SubmitLimits

T = TypeVar("T")


def job_of(row: Any) -> Job:
    """A row of the table of jobs, with its position."""
    result, error = row["result"], row["error"]
    return Job(
        number=row["number"],
        id=row["id"],
        owner=row["owner"] or None,
        priority=row["priority"],
        state=row["state"],
        position=row["position"],
        request=known(EncodeRequest, row["request"]),
        image=known(SourceImage, row["image"]),
        attempt=row["attempt"],
        crashes=row["crashes"],
        created_at=row["created_at"],
        started_at=row["started_at"],
        finished_at=row["finished_at"],
        result=known(EncodeResult, result) if result else None,
        error=known(JobError, error) if error else None,
        stored_bytes=row["stored_bytes"],
    )


def known(kind: type[T], text: str) -> T:
    """A dataclass from its JSON; what a later version of this service has added is left out."""
    names = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    return kind(**{name: value for name, value in json.loads(text).items() if name in names})


def queued(db: Database, owner: str | None = None) -> int:
    """How many jobs wait, of one owner or of all."""
    query = "SELECT count(*) AS jobs FROM jobs WHERE state = 'queued' AND owner = coalesce(?, owner)"
    return int(db.execute(query, (owner,)).fetchone()["jobs"])


def stored_bytes(db: Database, owner: str | None = None) -> int:
    """Bytes kept for the jobs of one owner or of all."""
    query = "SELECT coalesce(sum(stored_bytes), 0) AS bytes FROM jobs WHERE owner = coalesce(?, owner)"
    return int(db.execute(query, (owner,)).fetchone()["bytes"])


def check_limits(db: Database, job: NewJob, limits: SubmitLimits) -> None:
    """Raises QueueFullError, OwnQueueFullError or QuotaError if the job would exceed the limits."""
    owner = job.owner or ""
    if queued(db) >= limits.queue_length:
        raise QueueFullError
    if limits.own_queue_length and queued(db, owner) >= limits.own_queue_length:
        raise OwnQueueFullError
    size = job.image.size_bytes
    if limits.own_quota and stored_bytes(db, owner) + size > limits.own_quota:
        raise QuotaError(of_owner=True)
    if limits.quota and stored_bytes(db) + size > limits.quota:
        raise QuotaError(of_owner=False)


def bytes_of(result: EncodeResult) -> int:
    """Of its bitstream."""
    return int(result.stats.get("bytes", 0))


def to_json(value: Any) -> str:
    """Of a dataclass."""
    return json.dumps(asdict(value))
