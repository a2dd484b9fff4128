"""Tables and statements in the SQL that SQLite and PostgreSQL share: a `?` for a value, epoch() for the time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

SCHEMA_VERSION = 4
# {number}: the type of an automatic row number, which depends on the database. The table `stored` counts jobs and their
# bytes by owner and state; each database adds triggers that update it.
SCHEMA = """
CREATE TABLE stored (
    owner TEXT NOT NULL,
    state TEXT NOT NULL,
    jobs  BIGINT NOT NULL,
    bytes BIGINT NOT NULL,
    PRIMARY KEY (owner, state)
);
CREATE TABLE workers (
    name    TEXT PRIMARY KEY,
    seen_at DOUBLE PRECISION NOT NULL
);
CREATE TABLE deliveries (
    job      TEXT NOT NULL,
    address  TEXT NOT NULL,
    body     TEXT NOT NULL,
    ended_at DOUBLE PRECISION NOT NULL,
    due_at   DOUBLE PRECISION NOT NULL,
    PRIMARY KEY (job, address)
);
CREATE INDEX deliveries_by_time ON deliveries (address, due_at);
CREATE TABLE totals (
    name   TEXT PRIMARY KEY,
    amount DOUBLE PRECISION NOT NULL
);
CREATE TABLE jobs (
    number          {number},
    id              TEXT NOT NULL UNIQUE,
    owner           TEXT NOT NULL DEFAULT '',
    priority        TEXT NOT NULL DEFAULT 'interactive' CHECK (priority IN ('interactive', 'bulk')),
    state           TEXT NOT NULL DEFAULT 'queued' CHECK (state IN ('queued', 'running', 'done', 'failed')),
    idempotency_key TEXT,
    fingerprint     TEXT NOT NULL,
    request         TEXT NOT NULL,
    image           TEXT NOT NULL,
    attempt         INTEGER NOT NULL DEFAULT 0,
    crashes         INTEGER NOT NULL DEFAULT 0,
    worker          TEXT,
    lease_until     DOUBLE PRECISION,
    created_at      DOUBLE PRECISION NOT NULL,
    started_at      DOUBLE PRECISION,
    finished_at     DOUBLE PRECISION,
    result          TEXT CHECK ((state = 'done') = (result IS NOT NULL)),
    error           TEXT,
    image_bytes     BIGINT NOT NULL,
    file_bytes      BIGINT NOT NULL DEFAULT 0,
    stopped         INTEGER NOT NULL DEFAULT 0,
    losses          INTEGER NOT NULL DEFAULT 0,
    UNIQUE (owner, idempotency_key)
);
CREATE INDEX jobs_by_state ON jobs (state, number);
CREATE INDEX jobs_by_owner ON jobs (owner, number);
CREATE TABLE served (
    owner TEXT PRIMARY KEY,
    at    DOUBLE PRECISION NOT NULL
);
CREATE TABLE trace (
    job   BIGINT NOT NULL REFERENCES jobs (number) ON DELETE CASCADE,
    place INTEGER NOT NULL,
    point TEXT NOT NULL,
    PRIMARY KEY (job, place)
);
"""
COUNTS = """
SELECT epoch() - (SELECT min(created_at) FROM jobs WHERE state = 'queued') AS waiting_s,
    (SELECT count(*) FROM deliveries) AS deliveries,
    coalesce(epoch() - (SELECT min(ended_at) FROM deliveries), 0) AS delivery_waits_s
"""
SELECT_JOB = """
SELECT jobs.*, CASE WHEN state = 'queued' THEN (
    SELECT count(*) FROM jobs AS waiting
    WHERE waiting.state = 'queued'
    AND (waiting.priority = 'bulk', waiting.number) <= (jobs.priority = 'bulk', jobs.number)
) END AS position FROM jobs
"""
# For a page of jobs: counting the position of each separately takes 0.1 s a page when thousands wait.
SELECT_JOBS = """
WITH waiting AS (
    SELECT number, row_number() OVER (ORDER BY priority = 'bulk', number) AS position FROM jobs WHERE state = 'queued'
)
SELECT jobs.*, waiting.position FROM jobs LEFT JOIN waiting USING (number)
"""
# Owners take turns by the number of their running jobs, however many are queued.
CLAIM = """
UPDATE jobs SET state = 'running', attempt = attempt + 1, stopped = 0, worker = ?, started_at = epoch(),
    lease_until = epoch() + ?
WHERE state = 'queued' AND number = (
    WITH busy AS (SELECT owner, count(*) AS jobs FROM jobs WHERE state = 'running' GROUP BY owner)
    SELECT number FROM jobs LEFT JOIN busy ON busy.owner = jobs.owner LEFT JOIN served ON served.owner = jobs.owner
    WHERE state = 'queued'
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
PUT_BACK = "state = 'queued', error = ?, crashes = crashes + ?, losses = losses + ?"
FAIL = "state = 'failed', image_bytes = ? * image_bytes, finished_at = epoch()"
CLAIMED = "WHERE id = ? AND attempt = ? AND state = 'running'"
# A lease that was not renewed in time, or is too long because the clock was set back.
OVERDUE = "WHERE state = 'running' AND NOT (lease_until - epoch() BETWEEN ? AND ?)"
LOST = "WHERE id = ? AND attempt = ? AND lease_until = ? AND state = 'running'"


def other_version(version: object) -> str:
    """Return why a job table of another version cannot be used, and what to do."""
    known = f"this service reads version {SCHEMA_VERSION}"
    return f"the job table has version {version}, and {known}; install the service that wrote it"


class Database(Protocol):
    """A connection."""

    def execute(self, statement: str, values: Sequence[Any] = (), /) -> Any:
        """Run one statement. Returns a cursor whose rows are read by name, as in both databases' modules."""
        ...
