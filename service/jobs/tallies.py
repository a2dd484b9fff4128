"""What is kept beside the jobs: how many there are and their bytes, which files they need, and totals for /metrics.

Triggers keep the table `stored`, whoever changes a job. To count the jobs instead would take longer with each of them.
The totals grow when an attempt ends.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Literal, get_args

from service.jobs.job import Job, JobState
from service.jobs.statements import Database
from service.storage.files import bitstream_key, job_of_key, source_key

Outcome = Literal["finished", "failed", "retried", "put_off", "cancelled"]
OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)
OUTCOME_OF: Mapping[JobState, Outcome] = {"done": "finished", "failed": "failed", "queued": "retried"}
ENCODING, QUEUEING = "encode_seconds", "queue_seconds"
ADD = """
INSERT INTO totals VALUES (?, ?) ON CONFLICT (name) DO UPDATE SET amount = totals.amount + excluded.amount
"""
OF_OWNER = "SELECT CAST(coalesce(sum(bytes), 0) AS BIGINT) AS bytes FROM stored WHERE owner = coalesce(?, owner)"
BY_STATE = (
    "SELECT state, CAST(sum(jobs) AS BIGINT) AS jobs, CAST(sum(bytes) AS BIGINT) AS bytes FROM stored GROUP BY state"
)


def count(db: Database, outcome: Outcome) -> None:
    """Count a job with this outcome."""
    db.execute(ADD, (outcome, 1))


def conclude(db: Database, job: Job, *, put_off: bool = False) -> None:
    """Count the outcome of an attempt, and the times of a job that ended with it."""
    count(db, "put_off" if put_off else OUTCOME_OF[job.state])
    if job.finished_at and job.started_at:
        _observe(db, QUEUEING, job.started_at - job.created_at)
        if job.state == "done":
            _observe(db, ENCODING, job.finished_at - job.started_at)


def _observe(db: Database, name: str, seconds: float) -> None:
    """Add to the sum of these times, and to their count."""
    db.execute(ADD, (f"{name}_sum", max(0.0, seconds)))
    db.execute(ADD, (f"{name}_count", 1))


def totals(db: Database) -> Mapping[str, float]:
    """Return all totals by name. Those that are still zero are missing."""
    rows = db.execute("SELECT name, amount FROM totals WHERE name <> 'made_at'").fetchall()
    return {row["name"]: row["amount"] for row in rows}


def stored_bytes(db: Database, owner: str | None = None) -> int:
    """Return the bytes stored for the jobs of one owner or of all."""
    return int(db.execute(OF_OWNER, (owner,)).fetchone()["bytes"])


def by_state(db: Database) -> tuple[dict[str, int], int]:
    """Return the number of jobs by state, without those that have had none, and the bytes of all."""
    rows = db.execute(BY_STATE).fetchall()
    return {row["state"]: row["jobs"] for row in rows}, sum(row["bytes"] for row in rows)


def unneeded(db: Database, keys: list[str]) -> list[str]:
    """Return the storage keys, of at most some hundreds, that no job needs."""
    query = f"SELECT id, state, attempt, image_bytes FROM jobs WHERE id IN ({', '.join('?' * len(keys))})"
    needed = {key for row in db.execute(query, [job_of_key(key) for key in keys]).fetchall() for key in _keys_of(row)}
    return [key for key in keys if key not in needed]


def _keys_of(row: Any) -> Iterator[str]:
    if row["image_bytes"]:
        yield source_key(row["id"])
    if row["state"] in ("running", "done"):  # before it is published, and after
        yield bitstream_key(row["id"], row["attempt"])
