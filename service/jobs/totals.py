"""What became of jobs since the table was made, and how long encodes took: counted with the jobs, read by /metrics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from service.jobs.statements import Database

Ending = Literal["finished", "failed", "retried", "cancelled"]
ENDINGS: tuple[Ending, ...] = ("finished", "failed", "retried", "cancelled")
BUCKETS_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, float("inf"))
SECONDS = "encode_seconds"

ADD = """
INSERT INTO totals VALUES (?, ?) ON CONFLICT (name) DO UPDATE SET amount = totals.amount + excluded.amount
"""


def count(db: Database, ending: Ending) -> None:
    """One more job has come to this."""
    db.execute(ADD, (ending, 1))


def count_finished(db: Database, job_id: str) -> None:
    """The job is done, after an attempt that took its seconds."""
    row = db.execute("SELECT finished_at - started_at AS seconds FROM jobs WHERE id = ?", (job_id,)).fetchone()
    seconds = max(0.0, row["seconds"])
    count(db, "finished")
    db.execute(ADD, (SECONDS, seconds))
    db.execute(ADD, (bucket(next(most for most in BUCKETS_S if seconds <= most)), 1))


def bucket(most_s: float) -> str:
    """The name of the number of encodes that took at most so many seconds, and longer than the bucket before."""
    return f"{SECONDS} {most_s:g}"


def read(db: Database) -> Mapping[str, float]:
    """All of them, by name; what never happened is missing."""
    return {row["name"]: row["amount"] for row in db.execute("SELECT name, amount FROM totals").fetchall()}
