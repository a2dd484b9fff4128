"""The job table in SQLite: one file, one machine, nothing to install."""

from __future__ import annotations

import json
import queue
import sqlite3
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from service.jobs import (
    JOB_STATES,
    BackendError,
    Census,
    Claim,
    EncodeRequest,
    EncodeResult,
    Job,
    JobError,
    JsonObject,
    KeyReusedError,
    NewJob,
    OwnQueueFullError,
    QueueFullError,
    SourceImage,
)
from service.storage import source_key

BUSY_TIMEOUT_S = 30.0
SCHEMA_VERSION = 2
SCHEMA = """
CREATE TABLE jobs (
    number          INTEGER PRIMARY KEY AUTOINCREMENT,
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
    lease_until     REAL,
    created_at      REAL NOT NULL,
    started_at      REAL,
    finished_at     REAL,
    result          TEXT CHECK ((state = 'done') = (result IS NOT NULL)),
    error           TEXT,
    UNIQUE (owner, idempotency_key)
);
CREATE INDEX jobs_by_state ON jobs (state, number);
CREATE INDEX jobs_by_owner ON jobs (owner, number);
CREATE TABLE served (
    owner TEXT PRIMARY KEY,
    at    REAL NOT NULL
);
CREATE TABLE trace (
    job   INTEGER NOT NULL REFERENCES jobs (number) ON DELETE CASCADE,
    place INTEGER NOT NULL,
    point TEXT NOT NULL,
    PRIMARY KEY (job, place)
) WITHOUT ROWID;
"""
# From version 1, which knew no owners: new tables, filled from the old ones.
UPGRADE_FROM_1 = f"""
DROP INDEX jobs_by_state;
ALTER TABLE trace RENAME TO trace_1;
ALTER TABLE jobs RENAME TO jobs_1;
{SCHEMA}
INSERT INTO jobs (number, id, state, idempotency_key, fingerprint, request, image, attempt, crashes, worker,
    lease_until, created_at, started_at, finished_at, result, error)
SELECT number, id, state, idempotency_key, fingerprint, request, image, attempt, crashes, worker,
    lease_until, created_at, started_at, finished_at, result, error FROM jobs_1;
INSERT INTO trace SELECT job, place, point FROM trace_1;
DROP TABLE trace_1;
DROP TABLE jobs_1;
"""
SCRIPTS = {0: SCHEMA, 1: UPGRADE_FROM_1}
SELECT_JOB = """
SELECT jobs.*, CASE WHEN state = 'queued' THEN (
    SELECT count(*) FROM jobs AS waiting
    WHERE waiting.state = 'queued'
    AND (waiting.priority = 'bulk', waiting.number) <= (jobs.priority = 'bulk', jobs.number)
) END AS position FROM jobs
"""
# Owners take turns by what they have running just now, however many jobs of theirs wait.
NEXT_JOB = """
WITH busy AS (SELECT owner, count(*) AS jobs FROM jobs WHERE state = 'running' GROUP BY owner)
SELECT jobs.* FROM jobs LEFT JOIN busy ON busy.owner = jobs.owner LEFT JOIN served ON served.owner = jobs.owner
WHERE state = 'queued' AND (? = 0 OR coalesce(busy.jobs, 0) < ?)
ORDER BY priority = 'bulk', coalesce(busy.jobs, 0), coalesce(served.at, 0), number LIMIT 1
"""
MINE = "WHERE id = ? AND attempt = ? AND state = 'running'"
STALE = "state = 'running' AND lease_until < ?"


def _job(row: sqlite3.Row) -> Job:
    result, error = row["result"], row["error"]
    return Job(
        number=row["number"],
        id=row["id"],
        owner=row["owner"] or None,
        priority=row["priority"],
        state=row["state"],
        position=row["position"],
        request=EncodeRequest(**json.loads(row["request"])),
        image=SourceImage(**json.loads(row["image"])),
        attempt=row["attempt"],
        crashes=row["crashes"],
        created_at=row["created_at"],
        started_at=row["started_at"],
        finished_at=row["finished_at"],
        result=EncodeResult(**json.loads(result)) if result else None,
        error=JobError(**json.loads(error)) if error else None,
    )


def _queued(db: sqlite3.Connection, owner: str | None = None) -> int:
    """How many jobs wait, of one owner or of all."""
    query = "SELECT count(*) FROM jobs WHERE state = 'queued' AND owner = coalesce(?, owner)"
    return int(db.execute(query, (owner,)).fetchone()[0])


class SqliteJobs:
    """JobBackend on one SQLite file in WAL mode, every commit synced to disk.

    lease_s: seconds until a silent worker's job goes back; max_attempts: crashes that make a job fail;
    max_running_per_owner: jobs of one owner that run at once, 0 for any number.
    """

    def __init__(self, path: Path, *, lease_s: float, max_attempts: int, max_running_per_owner: int = 0) -> None:
        self._path = path
        self._lease_s = lease_s
        self._max_attempts = max_attempts
        self._max_running_per_owner = max_running_per_owner
        self._idle: queue.LifoQueue[sqlite3.Connection] = queue.LifoQueue()
        with self._transaction() as db:
            version = db.execute("PRAGMA user_version").fetchone()[0]
            if version > SCHEMA_VERSION:
                raise BackendError(f"{path} was written by a newer version of this service")
            if version < SCHEMA_VERSION:
                for statement in SCRIPTS[version].split(";")[:-1]:
                    db.execute(statement)
                db.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")

    def _connect(self) -> sqlite3.Connection:
        # A connection serves one thread at a time, though not always the same one.
        db = sqlite3.connect(self._path, BUSY_TIMEOUT_S, isolation_level=None, check_same_thread=False)
        db.row_factory = sqlite3.Row
        try:
            db.execute("PRAGMA journal_mode = WAL")
            db.execute("PRAGMA synchronous = FULL")
            db.execute("PRAGMA foreign_keys = ON")
        except sqlite3.Error:
            db.close()
            raise
        return db

    @contextmanager
    def _connection(self) -> Iterator[sqlite3.Connection]:
        """A connection for reading; after an SQLite error it is thrown away, so the next try is fresh."""
        db: sqlite3.Connection | None = None
        try:
            try:
                db = self._idle.get_nowait()
            except queue.Empty:
                db = self._connect()
            yield db
        except sqlite3.Error as error:
            if db is not None:
                db.close()
            raise BackendError(f"{self._path}: {error}") from error
        except BaseException:
            if db is not None:
                self._idle.put(db)
            raise
        self._idle.put(db)

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """A connection that holds the write lock from the start, so no transaction fails half-way."""
        with self._connection() as db:
            db.execute("BEGIN IMMEDIATE")
            try:
                yield db
                db.execute("COMMIT")
            except BaseException:
                if db.in_transaction:
                    db.execute("ROLLBACK")
                raise

    def submit(self, job: NewJob, queue_length: int, own_queue_length: int = 0) -> tuple[Job, bool]:
        with self._transaction() as db:
            if job.idempotency_key is not None:
                query = SELECT_JOB + "WHERE owner = ? AND idempotency_key = ?"
                first = db.execute(query, (job.owner or "", job.idempotency_key)).fetchone()
                if first is not None:
                    if first["fingerprint"] != job.fingerprint:
                        raise KeyReusedError(job.idempotency_key)
                    return _job(first), False
            if _queued(db) >= queue_length:
                raise QueueFullError
            if own_queue_length and _queued(db, job.owner or "") >= own_queue_length:
                raise OwnQueueFullError
            request, image = json.dumps(asdict(job.request)), json.dumps(asdict(job.image))
            db.execute(
                "INSERT INTO jobs (id, owner, priority, idempotency_key, fingerprint, request, image, created_at)"
                " VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                (
                    job.id,
                    job.owner or "",
                    job.priority,
                    job.idempotency_key,
                    job.fingerprint,
                    request,
                    image,
                    time.time(),
                ),
            )
            return _job(db.execute(SELECT_JOB + "WHERE id = ?", (job.id,)).fetchone()), True

    def find_key(self, idempotency_key: str, owner: str | None = None) -> Job | None:
        return self._one("WHERE owner = ? AND idempotency_key = ?", owner or "", idempotency_key)

    def get(self, job_id: str, owner: str | None = None) -> Job | None:
        return self._one("WHERE id = ? AND owner = coalesce(?, owner)", job_id, owner)

    def _one(self, condition: str, *values: str | None) -> Job | None:
        with self._connection() as db:
            row = db.execute(SELECT_JOB + condition, values).fetchone()
        return None if row is None else _job(row)

    def queued(self, owner: str | None = None) -> int:
        with self._connection() as db:
            return _queued(db, owner)

    def census(self) -> Census:
        with self._connection() as db:
            rows = db.execute("SELECT state, count(*) AS jobs FROM jobs GROUP BY state").fetchall()
            times = db.execute(
                "SELECT (SELECT min(created_at) FROM jobs WHERE state = 'queued') AS waiting_since,"
                " (SELECT max(started_at) FROM jobs) AS claimed_at"
            ).fetchone()
        counts = {row["state"]: row["jobs"] for row in rows}
        return Census({state: counts.get(state, 0) for state in JOB_STATES}, *times)

    def page(self, limit: int, before: int | None = None, owner: str | None = None) -> list[Job]:
        conditions: dict[str, Any] = {"number < ?": before, "owner = ?": owner}
        chosen = {condition: value for condition, value in conditions.items() if value is not None}
        where = f"WHERE {' AND '.join(chosen)}" if chosen else ""
        query = f"{SELECT_JOB} {where} ORDER BY number DESC LIMIT ?"
        with self._connection() as db:
            return [_job(row) for row in db.execute(query, (*chosen.values(), limit)).fetchall()]

    def trace(self, job_id: str) -> list[JsonObject]:
        query = "SELECT point FROM trace JOIN jobs ON number = job WHERE id = ? ORDER BY place"
        with self._connection() as db:
            return [json.loads(row["point"]) for row in db.execute(query, (job_id,)).fetchall()]

    def remove(self, job_id: str) -> Job | None:
        with self._transaction() as db:
            row = db.execute(SELECT_JOB + "WHERE id = ?", (job_id,)).fetchone()
            db.execute("DELETE FROM jobs WHERE id = ?", (job_id,))
        return None if row is None else _job(row)

    def reconcile(self) -> list[Job]:
        with self._connection() as db:  # most calls find nothing, and need no write lock to see it
            if db.execute(f"SELECT 1 FROM jobs WHERE {STALE} LIMIT 1", (time.time(),)).fetchone() is None:
                return []
        failed = []
        with self._transaction() as db:
            for row in db.execute(f"{SELECT_JOB} WHERE {STALE}", (time.time(),)).fetchall():
                job = _job(row)
                claim = Claim(job.id, job.attempt, job.request)
                self._end_attempt(db, claim, JobError("crashed", "the worker of this job was lost"), True)
                if job.crashes + 1 >= self._max_attempts:
                    failed.append(job)
        return failed

    def claim(self, worker: str) -> Claim | None:
        if self.queued() == 0:  # polled several times a second: look before taking the write lock
            return None
        now = time.time()
        with self._transaction() as db:
            limit = self._max_running_per_owner
            row = db.execute(NEXT_JOB, (limit, limit)).fetchone()
            if row is None:
                return None
            db.execute("INSERT OR REPLACE INTO served VALUES (?, ?)", (row["owner"], now))
            db.execute("DELETE FROM trace WHERE job = ?", (row["number"],))
            db.execute(
                "UPDATE jobs SET state = 'running', attempt = attempt + 1, worker = ?, lease_until = ?,"
                " started_at = ? WHERE number = ?",
                (worker, now + self._lease_s, now, row["number"]),
            )
            return Claim(row["id"], row["attempt"] + 1, EncodeRequest(**json.loads(row["request"])))

    def heartbeat(self, claim: Claim, points: Sequence[JsonObject], first: int) -> bool:
        with self._transaction() as db:
            if not self._change(db, claim, "lease_until = ?", time.time() + self._lease_s):
                return False
            db.executemany(
                "INSERT OR REPLACE INTO trace SELECT number, ?, ? FROM jobs WHERE id = ?",
                [(place, json.dumps(point), claim.job_id) for place, point in enumerate(points, first)],
            )
            return True

    def finish(self, claim: Claim, result: EncodeResult) -> bool:
        text = json.dumps(asdict(result))
        with self._transaction() as db:
            if self._change(db, claim, "state = 'done', result = ?, error = NULL, finished_at = ?", text, time.time()):
                return True
            # A commit can succeed and still be reported as failed; the repeated call must not lose the job.
            row = db.execute("SELECT result FROM jobs WHERE id = ?", (claim.job_id,)).fetchone()
            return row is not None and row["result"] == text

    def fail(self, claim: Claim, error: JobError, *, retry: bool) -> bool:
        with self._transaction() as db:
            return self._end_attempt(db, claim, error, retry)

    def release(self, claim: Claim) -> bool:
        with self._transaction() as db:
            return self._change(db, claim, "state = 'queued', started_at = NULL")

    def _end_attempt(self, db: sqlite3.Connection, claim: Claim, error: JobError, retry: bool) -> bool:
        text = json.dumps(asdict(error))
        if not retry:
            return self._change(db, claim, "state = 'failed', error = ?, finished_at = ?", text, time.time())
        return self._change(
            db,
            claim,
            "crashes = crashes + 1, error = ?,"
            " state = CASE WHEN crashes + 1 < ? THEN 'queued' ELSE 'failed' END,"
            " finished_at = CASE WHEN crashes + 1 < ? THEN NULL ELSE ? END",
            *(text, self._max_attempts, self._max_attempts, time.time()),
        )

    @staticmethod
    def _change(db: sqlite3.Connection, claim: Claim, assignments: str, *values: Any) -> bool:
        """Update the claimed job under its fencing token; False if the token is stale."""
        statement = f"UPDATE jobs SET {assignments} {MINE}"
        return db.execute(statement, (*values, claim.job_id, claim.attempt)).rowcount == 1

    def live_keys(self) -> set[str]:
        with self._connection() as db:
            rows = db.execute("SELECT id, state, result FROM jobs").fetchall()
        waiting = {source_key(row["id"]) for row in rows if row["state"] in ("queued", "running")}
        done = {json.loads(row["result"])["bitstream_key"] for row in rows if row["result"]}
        return waiting | done

    def close(self) -> None:
        while True:
            try:
                self._idle.get_nowait().close()
            except queue.Empty:
                return
