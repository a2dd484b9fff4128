"""What became of jobs since the table was made, and how long encodes took: counted with the jobs, read by /metrics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from service.jobs.job import Job, JobState
from service.jobs.statements import Database

Ending = Literal["finished", "failed", "retried", "cancelled"]
ENDINGS: tuple[Ending, ...] = ("finished", "failed", "retried", "cancelled")
ENDING_OF: Mapping[JobState, Ending] = {"done": "finished", "failed": "failed", "queued": "retried"}
BUCKETS_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, float("inf"))
SECONDS = "encode_seconds"

ADD = """
INSERT INTO totals VALUES (?, ?) ON CONFLICT (name) DO UPDATE SET amount = totals.amount + excluded.amount
"""


def count(db: Database, ending: Ending) -> None:
    """One more job has come to this."""
    db.execute(ADD, (ending, 1))


def count_attempt(db: Database, job: Job) -> None:
    """An attempt at the job has ended, and the job with it, or it waits for the next."""
    count(db, ENDING_OF[job.state])
    if job.state == "done" and job.finished_at and job.started_at:
        seconds = max(0.0, job.finished_at - job.started_at)
        db.execute(ADD, (SECONDS, seconds))
        db.execute(ADD, (bucket(next(most for most in BUCKETS_S if seconds <= most)), 1))


def bucket(most_s: float) -> str:
    """The name of the number of encodes that took at most so many seconds, and longer than the bucket before."""
    return f"{SECONDS} {most_s:g}"


def read(db: Database) -> Mapping[str, float]:
    """All of them, by name; what never happened is missing."""
    return {row["name"]: row["amount"] for row in db.execute("SELECT name, amount FROM totals").fetchall()}
