"""What is written down when an attempt ends.

Totals, since the table was made, are read by /metrics. Notices that a job has ended are for the operator's addresses:
rows beside the jobs, until they are delivered.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal, get_args

from service.jobs.job import FINAL_STATES, Job, JobState
from service.jobs.statements import Database

Ending = Literal["finished", "failed", "retried", "cancelled"]
ENDINGS: tuple[Ending, ...] = get_args(Ending)
ENDING_OF: Mapping[JobState, Ending] = {"done": "finished", "failed": "failed", "queued": "retried"}
BUCKETS_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, float("inf"))
SECONDS = "encode_seconds"
# The pause before the next try is as long as the notice has waited so far, and a bit: each is twice the one before.
FIRST_PAUSE_S, LONGEST_PAUSE_S = 10.0, 3600.0
KEPT_S = 3 * 86_400.0  # for which a notice is tried

ADD = """
INSERT INTO totals VALUES (?, ?) ON CONFLICT (name) DO UPDATE SET amount = totals.amount + excluded.amount
"""
NOTE = "INSERT INTO notices VALUES (?, ?, ?, epoch(), epoch()) ON CONFLICT (job, address) DO NOTHING"
# Due too if it is put off for longer than it ever is: then the clock was put back.
DUE = """
WITH clock AS MATERIALIZED (SELECT epoch() AS now)
SELECT job, body, due_at, now - ended_at AS age_s FROM notices, clock
WHERE address = ? AND (due_at <= now OR due_at - now > ? OR due_at - now > ? + now - ended_at) ORDER BY due_at LIMIT 1
"""
PUT_OFF = """
UPDATE notices SET due_at = epoch() + ?, ended_at = CASE WHEN ended_at > epoch() THEN epoch() ELSE ended_at END
WHERE job = ? AND address = ? AND due_at = ?
"""


FORWARD = """
INSERT INTO notices SELECT job, ?, body, ended_at, epoch() FROM notices WHERE address NOT IN ({known})
ON CONFLICT (job, address) DO NOTHING
"""
ASTRAY = "DELETE FROM notices WHERE address NOT IN ({known})"


@dataclass(frozen=True)
class Notice:
    """One job, one address. body: JSON."""

    job_id: str
    address: str
    body: str


def count(db: Database, ending: Ending) -> None:
    """Count a job that ended so."""
    db.execute(ADD, (ending, 1))


def conclude(db: Database, job: Job, addresses: Sequence[str]) -> None:
    """Count how an attempt at the job ended; if the job ended with it, leave a notice for each address."""
    count(db, ENDING_OF[job.state])
    if job.state == "done" and job.finished_at and job.started_at:
        seconds = max(0.0, job.finished_at - job.started_at)
        db.execute(ADD, (SECONDS, seconds))
        db.execute(ADD, (bucket(next(most for most in BUCKETS_S if seconds <= most)), 1))
    for address in addresses if job.state in FINAL_STATES else ():
        db.execute(NOTE, (job.id, address, _body(job)))


def bucket(most_s: float) -> str:
    """The total that counts encodes of at most this many seconds, and more than those of the bucket before."""
    return f"{SECONDS} {most_s:g}"


def totals(db: Database) -> Mapping[str, float]:
    """All totals, by name; what never happened is missing."""
    return {row["name"]: row["amount"] for row in db.execute("SELECT name, amount FROM totals").fetchall()}


def take_notice(db: Database, address: str) -> Notice | None:
    """The notice of the address that has waited longest for a try, if this caller is the first to take it.

    It is due again after a pause, whatever becomes of the worker that tries now.
    """
    row = db.execute(DUE, (address, LONGEST_PAUSE_S, FIRST_PAUSE_S)).fetchone()
    if row is None:
        return None
    pause_s = min(FIRST_PAUSE_S + max(0.0, row["age_s"]), LONGEST_PAUSE_S)
    first = db.execute(PUT_OFF, (pause_s, row["job"], address, row["due_at"])).rowcount == 1
    return Notice(row["job"], address, row["body"]) if first else None


def forget_notice(db: Database, notice: Notice) -> None:
    """Delete a notice that was delivered."""
    db.execute("DELETE FROM notices WHERE job = ? AND address = ?", (notice.job_id, notice.address))


def forward_notices(db: Database, addresses: Sequence[str]) -> int:
    """Let notices to addresses other than these go to these, and at once; returns how many there were."""
    known = ", ".join("?" * len(addresses))
    for address in addresses:
        db.execute(FORWARD.format(known=known), (address, *addresses))
    return int(db.execute(ASTRAY.format(known=known), addresses).rowcount)


def give_up_notices(db: Database) -> int:
    """Delete notices that were tried for long enough; returns how many."""
    return int(db.execute("DELETE FROM notices WHERE ended_at < epoch() - ?", (KEPT_S,)).rowcount)


def _body(job: Job) -> str:
    """Type, timestamp and data, as in Standard Webhooks."""
    ended = datetime.fromtimestamp(job.finished_at or 0.0, UTC)
    data = {
        **{"id": job.id, "key": job.owner, "state": job.state, "attempt": job.attempt},
        "error": None if job.error is None else {"code": job.error.code, "detail": job.error.detail},
        "bytes": None if job.result is None else job.result.stats.get("bytes"),
        "sha256": None if job.result is None else job.result.sha256,
    }
    return json.dumps({"type": f"job.{job.state}", "timestamp": ended.isoformat(), "data": data})
