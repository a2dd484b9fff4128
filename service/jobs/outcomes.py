"""Rows written when an attempt ends: totals for /metrics, and webhooks.

Webhooks wait beside the jobs until they are delivered to the operator's addresses.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal, get_args

from service.jobs.job import FINAL_STATES, Job, JobState
from service.jobs.statements import Database

Outcome = Literal["finished", "failed", "retried", "put_off", "cancelled"]
OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)
OUTCOME_OF: Mapping[JobState, Outcome] = {"done": "finished", "failed": "failed", "queued": "retried"}
ENCODING, QUEUEING = "encode_seconds", "queue_seconds"
BOUNDS_S = tuple(0.25 * 2**step for step in range(16))  # 0.25 s to 2.3 hours
# Each pause is about as long as the delivery has waited until then, and so doubles.
FIRST_PAUSE_S, MAX_PAUSE_S = 10.0, 3600.0
RETRY_FOR_S = 3 * 86_400.0  # retry time of a delivery

ADD = """
INSERT INTO totals VALUES (?, ?) ON CONFLICT (name) DO UPDATE SET amount = totals.amount + excluded.amount
"""
ADD_DELIVERY = "INSERT INTO deliveries VALUES (?, ?, ?, epoch(), epoch()) ON CONFLICT (job, address) DO NOTHING"
# The first delivery by time. Whether it is due is not a condition, since epoch() would then be called for every row.
NEXT = """
SELECT job, body, due_at, epoch() - ended_at AS age_s, due_at <= epoch() AS is_due FROM deliveries WHERE address = ?
ORDER BY due_at LIMIT 1
"""
POSTPONE = "UPDATE deliveries SET due_at = epoch() + ? WHERE job = ? AND address = ? AND due_at = ?"


@dataclass(frozen=True)
class Delivery:
    """A webhook to deliver: one job, one address. body: JSON."""

    job_id: str
    address: str
    body: str


def count(db: Database, outcome: Outcome) -> None:
    """Count a job with this outcome."""
    db.execute(ADD, (outcome, 1))


def conclude(db: Database, job: Job, addresses: Sequence[str], *, put_off: bool = False) -> None:
    """Count the outcome of an attempt; if the job ended with it, add a delivery for each address."""
    count(db, "put_off" if put_off else OUTCOME_OF[job.state])
    if job.finished_at and job.started_at:
        _observe(db, QUEUEING, job.started_at - job.created_at)
        if job.state == "done":
            _observe(db, ENCODING, job.finished_at - job.started_at)
    for address in addresses if job.state in FINAL_STATES else ():
        db.execute(ADD_DELIVERY, (job.id, address, _body(job)))


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


def take_delivery(db: Database, address: str) -> Delivery | None:
    """Take the delivery to the address that is due for longest; None if there is none, or another worker took it.

    It is due again after a pause, unless it is deleted.
    """
    row = db.execute(NEXT, (address,)).fetchone()
    if row is None or not row["is_due"]:
        return None
    pause_s = min(FIRST_PAUSE_S + max(0.0, row["age_s"]), MAX_PAUSE_S)
    first = db.execute(POSTPONE, (pause_s, row["job"], address, row["due_at"])).rowcount == 1
    return Delivery(row["job"], address, row["body"]) if first else None


def _body(job: Job) -> str:
    """Return the body of a webhook: type, timestamp and data, as in Standard Webhooks."""
    ended = datetime.fromtimestamp(job.finished_at or 0.0, UTC)
    data = {
        **{"id": job.id, "key": job.owner, "state": job.state, "attempt": job.attempt},
        "error": None if job.error is None else {"code": job.error.code, "detail": job.error.detail},
        "bytes": None if job.result is None else job.result.stats.get("bytes"),
        "sha256": None if job.result is None else job.result.sha256,
    }
    return json.dumps({"type": f"job.{job.state}", "timestamp": ended.isoformat(), "data": data})
