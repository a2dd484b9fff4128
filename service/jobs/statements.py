"""Statements in the SQL that SQLite and PostgreSQL share: a `?` for a value, epoch() for the time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

PUT_OFF_S = 60.0  # until a job whose image is lost is tried again, so that others go on and operators have 20 minutes
# A queued job with a lease is put off until then. If that is further away than any pause, the clock was set back.
DUE = f"NOT coalesce(lease_until > epoch() AND lease_until <= epoch() + {PUT_OFF_S}, FALSE)"
# A job that was put off has waited since it was due again, and waits for no worker before.
COUNTS = f"""
SELECT epoch() - (
        SELECT coalesce(lease_until, created_at) FROM jobs WHERE state = 'queued' AND {DUE} ORDER BY number LIMIT 1
    ) AS waiting_s
"""
INSERT = """
INSERT INTO jobs (id, owner, client, priority, idempotency_key, fingerprint, request, image, image_bytes, created_at)
VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, epoch()) RETURNING *
"""
QUEUED = "SELECT CAST(coalesce(sum(jobs), 0) AS BIGINT) AS jobs FROM stored WHERE state = 'queued'"
QUEUED_BY = "SELECT count(*) AS jobs FROM jobs WHERE state = 'queued' AND client = ?"
POSITION = """
SELECT (SELECT count(*) FROM jobs WHERE state = 'queued' AND priority > ?)
    + (SELECT count(*) FROM jobs WHERE state = 'queued' AND priority = ? AND number <= ?) AS position
"""
# Owners take turns by the number of their running jobs. Of each, only the first queued job is looked at. A client,
# which may be somebody's address, is forgotten once its job runs.
CLAIM = f"""
UPDATE jobs SET state = 'running', attempt = attempt + 1, worker = ?, started_at = epoch(),
    lease_until = epoch() + ?, client = ''
WHERE state = 'queued' AND number = (
    SELECT number FROM stored JOIN jobs ON number = (
        SELECT number FROM jobs WHERE state = 'queued' AND owner = stored.owner AND {DUE}
        ORDER BY priority DESC, number LIMIT 1
    )
    LEFT JOIN stored AS busy ON busy.owner = stored.owner AND busy.state = 'running'
    LEFT JOIN served ON served.owner = stored.owner
    WHERE stored.state = 'queued' AND stored.jobs > 0
    ORDER BY priority = 'bulk', coalesce(busy.jobs, 0), coalesce(served.at, 0), number LIMIT 1
) RETURNING *
"""
REGISTER = "INSERT INTO workers VALUES (?, epoch()) ON CONFLICT (name) DO UPDATE SET seen_at = excluded.seen_at"
SEEN = "SELECT name, epoch() - seen_at AS seconds FROM workers"
SERVED = """
INSERT INTO served SELECT owner, started_at FROM jobs WHERE number = ?
ON CONFLICT (owner) DO UPDATE SET at = excluded.at
"""
TRACE_POINT = """
INSERT INTO trace SELECT number, ?, ? FROM jobs WHERE id = ?
ON CONFLICT (job, place) DO UPDATE SET point = excluded.point
"""
DONE = "state = 'done', result = ?, file_bytes = ?, image_bytes = ? * image_bytes, error = NULL, finished_at = epoch()"
PUT_BACK = "state = 'queued', error = ?, crashes = crashes + ?, losses = losses + ?, lease_until = epoch() + ?"
RELEASE = "state = 'queued', started_at = NULL, lease_until = epoch() + ?"
FAIL = "state = 'failed', image_bytes = ? * image_bytes, finished_at = epoch()"
# It is due at once, and has waited since then.
RETRY = """
state = 'queued', crashes = 0, losses = 0, error = NULL, started_at = NULL, finished_at = NULL, lease_until = epoch()
"""
RETRIED = "WHERE id = ? AND state = 'failed' AND image_bytes > 0"
CLAIMED = "WHERE id = ? AND attempt = ? AND state = 'running'"
# A lease that was not renewed in time, or is too long because the clock was set back.
OVERDUE = "WHERE state = 'running' AND NOT (lease_until - epoch() BETWEEN ? AND ?)"
LOST = "WHERE id = ? AND attempt = ? AND lease_until = ? AND state = 'running'"


class Database(Protocol):
    """A connection."""

    def execute(self, statement: str, values: Sequence[Any] = (), /) -> Any:
        """Run one statement. Returns a cursor whose rows are read by name, as in both databases' modules."""
