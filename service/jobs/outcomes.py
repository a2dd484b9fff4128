"""The totals for /metrics, which grow when an attempt ends."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Literal, get_args

from service.jobs.job import Job, JobState
from service.jobs.statements import Database

Outcome = Literal["finished", "failed", "retried", "put_off", "cancelled"]
OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)
OUTCOME_OF: Mapping[JobState, Outcome] = {"done": "finished", "failed": "failed", "queued": "retried"}
ENCODING, QUEUEING = "encode_seconds", "queue_seconds"
BOUNDS_S = tuple(0.25 * 2**step for step in range(16))  # 0.25 s to 2.3 hours
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
    """Add a value to a histogram: to its sum, and to the count of its bucket."""
    db.execute(ADD, (total_of(name), max(0.0, seconds)))
    bound_s = next((bound_s for bound_s in BOUNDS_S if seconds <= bound_s), math.inf)
    db.execute(ADD, (_bucket(name, bound_s), 1))


def total_of(name: str) -> str:
    """Return the name of a histogram's sum."""
    return f"{name}_sum"


def _bucket(name: str, bound_s: float) -> str:
    return f"{name}_le_{bound_s:g}"


def histogram(so_far: Mapping[str, float], name: str) -> Iterator[tuple[float, float]]:
    """Yield each bound, and how many values were within it."""
    number = 0.0
    for bound_s in (*BOUNDS_S, math.inf):
        number += so_far.get(_bucket(name, bound_s), 0.0)
        yield bound_s, number


def totals(db: Database) -> Mapping[str, float]:
    """Return all totals by name. Those that are still zero are missing."""
    rows = db.execute("SELECT name, amount FROM totals WHERE name <> 'made_at'").fetchall()
    return {row["name"]: row["amount"] for row in rows}
