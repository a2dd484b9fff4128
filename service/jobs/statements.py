"""Statements in the SQL that SQLite and PostgreSQL share: a `?` for a value, epoch() for the time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

# A job that was put off has waited since it was due again, and waits for no worker before.
COUNTS = """
SELECT epoch() - (
        SELECT coalesce(lease_until, created_at) FROM jobs
        WHERE state = 'queued' AND coalesce(lease_until, 0) <= epoch() ORDER BY number LIMIT 1
    ) AS waiting_s
"""
INSERT = """
INSERT INTO jobs (id, owner, client, priority, idempotency_key, fingerprint, request, image, image_bytes, created_at)
VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, epoch()) RETURNING *, NULL AS position
"""
QUEUED = "SELECT CAST(coalesce(sum(jobs), 0) AS BIGINT) AS jobs FROM stored WHERE state = 'queued'"
QUEUED_BY = "SELECT count(*) AS jobs FROM jobs WHERE state = 'queued' AND client = ?"
SELECT_JOB = "SELECT *, NULL AS position FROM jobs"
# With positions, which take longer to find with each job that waits. Each is counted from that of the job before, since
# to count from the front of the queue for each of a page takes 0.1 s when thousands wait.
SELECT_JOBS = """
WITH chosen AS (
    SELECT jobs.*, lag(number, 1, 0) OVER (PARTITION BY state, priority ORDER BY number) AS previous
    FROM (SELECT * FROM jobs {where} ORDER BY number DESC LIMIT ?) AS jobs
)
SELECT chosen.*, CASE WHEN state = 'queued' THEN CAST(
    CASE priority WHEN 'bulk' THEN (
        SELECT count(*) FROM jobs WHERE state = 'queued' AND priority = 'interactive'
    ) ELSE 0 END + sum((
        SELECT count(*) FROM jobs AS waiting WHERE chosen.state = 'queued' AND waiting.state = 'queued'
        AND waiting.priority = chosen.priority AND waiting.number > chosen.previous AND waiting.number <= chosen.number
    )) OVER (PARTITION BY state, priority ORDER BY number)
AS BIGINT) END AS position FROM chosen ORDER BY number DESC
"""
# Owners take turns by the number of their running jobs. Of each, only the first queued job is looked at. A client,
# which may be somebody's address, is forgotten once its job runs. A queued job with a lease is put off until then.
CLAIM = """
UPDATE jobs SET state = 'running', attempt = attempt + 1, stopped = 0, worker = ?, started_at = epoch(),
    lease_until = epoch() + ?, client = ''
WHERE state = 'queued' AND number = (
    SELECT number FROM stored JOIN jobs ON number = (
        SELECT number FROM jobs AS own WHERE own.state = 'queued' AND own.owner = stored.owner
        AND coalesce(own.lease_until, 0) <= epoch()
        ORDER BY priority DESC, number LIMIT 1
    )
    LEFT JOIN stored AS busy ON busy.owner = stored.owner AND busy.state = 'running'
    LEFT JOIN served ON served.owner = stored.owner
    WHERE stored.state = 'queued' AND stored.jobs > 0
    ORDER BY priority = 'bulk', coalesce(busy.jobs, 0), coalesce(served.at, 0), number LIMIT 1
) RETURNING *, NULL AS position
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
CLAIMED = "WHERE id = ? AND attempt = ? AND state = 'running'"
# A lease that was not renewed in time, or is too long because the clock was set back.
OVERDUE = "WHERE state = 'running' AND NOT (lease_until - epoch() BETWEEN ? AND ?)"
LOST = "WHERE id = ? AND attempt = ? AND lease_until = ? AND state = 'running'"


class Database(Protocol):
    """A connection."""

    def execute(self, statement: str, values: Sequence[Any] = (), /) -> Any:
        """Run one statement. Returns a cursor whose rows are read by name, as in both databases' modules."""
