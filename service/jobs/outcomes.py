"""The totals for /metrics, which grow when an attempt ends."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, get_args

from service.jobs.job import Job, JobState
from service.jobs.statements import Database

Outcome = Literal["finished", "failed", "retried", "put_off", "cancelled"]
OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)
OUTCOME_OF: Mapping[JobState, Outcome] = {"done": "finished", "failed": "failed", "queued": "retried"}
ENCODING, QUEUEING = "encode_seconds", "queue_seconds"
ADD = """
INSERT INTO totals VALUES (?, ?) ON CONFLICT (name) DO UPDATE SET amount = totals.amount + excluded.amount
"""


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
