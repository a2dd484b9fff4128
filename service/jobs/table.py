"""The job table, independent of the database.

sqlite.py and postgres.py contain the differences: connections, transactions and the set-up.
"""

from __future__ import annotations

import json
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from itertools import islice
from typing import Any

from service.errors import KeyReusedError, LimitError
from service.jobs import statements as sql, tallies
from service.jobs.job import (
    FINAL_STATES,
    JOB_STATES,
    Counts,
    EncodeResult,
    Job,
    JobError,
    JobState,
    JsonObject,
    NewJob,
    as_json,
    job_of,
    row_of,
)
from service.jobs.statements import Database
from service.settings import Settings

# What happens to a job through no fault of its own.
WORKER_LOST = JobError("crashed", "the worker of this job was lost")
IMAGE_LOST = JobError("crashed", "the image is missing from the storage, or is not whole there")
NO_PROCESSOR = JobError("timed_out", "the machine was too busy to encode the image in time")
PUT_OFF = (IMAGE_LOST, NO_PROCESSOR)  # until then, others go first
# A worker that was silent for half of its lease is watched for the other half before it counts as lost.
WATCHED = 1 / 2
MAX_ATTEMPTS = 4  # crashes until a job fails
MAX_LOSSES = 20  # until a job fails: few jobs are the cause of a lost worker, but one might be
KEYS_AT_ONCE = 500  # of a query
FORGET_AFTER_S = 900.0  # a worker that is silent for longer is removed


class JobTable(ABC):
    """All jobs, in a database that a subclass connects to.

    Every method may raise JobTableError, and may be called from any thread. Its changes are on disk when it returns.
    """

    poll_s = 0.1  # pause of a worker that has found no job

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._overdue: dict[tuple[str, int, float], float] = {}  # claims, and since when (monotonic seconds)

    @abstractmethod
    def _connection(self) -> AbstractContextManager[Database]:
        """Provide a connection in autocommit mode. Within, the database's errors become JobTableError."""

    @abstractmethod
    def _transaction(self, *, alone: bool = False) -> AbstractContextManager[Database]:
        """Provide a connection for changes, which are all on disk at the end, or undone after an error.

        alone: nobody else accepts or claims a job until then, so that counts stay valid.
        """

    @abstractmethod
    def close(self) -> None:
        """Close all connections."""

    def check_writable(self) -> None:
        """Raise JobTableError if the database can be read but not changed."""
        with self._connection() as db:
            db.execute("DELETE FROM workers WHERE FALSE")

    def submit(self, job: NewJob) -> tuple[Job, bool]:
        """Insert a job; return it and True, or its owner's earlier job with the same key and False.

        Raises LimitError, or KeyReusedError if the key belongs to another request.
        """
        with self._transaction(alone=True) as db:
            if (first := _first(db, job.owner, job.idempotency_key, job.fingerprint)) is not None:
                return first, False
            self._check_queue(db, job.client)
            self._check_quotas(db, job.owner, job.image.bytes)
            return job_of(db.execute(sql.INSERT, row_of(job)).fetchone()), True

    def first(self, owner: str | None, idempotency_key: str, fingerprint: str) -> Job | None:
        """Return the owner's job that an earlier request with this key made, else None. Raises KeyReusedError."""
        with self._connection() as db:
            return _first(db, owner, idempotency_key, fingerprint)

    def check_queue(self, client: str = "", owner: str | None = None, idempotency_key: str | None = None) -> None:
        """Raise LimitError if the queue is full for a new job of a client; a job with a known key is not new."""
        with self._connection() as db:
            if _first(db, owner, idempotency_key) is None:
                self._check_queue(db, client)

    def _check_queue(self, db: Database, client: str) -> None:
        max_own = -(-self._settings.queue_length // 2)
        if db.execute(sql.QUEUED).fetchone()["jobs"] >= self._settings.queue_length:
            raise LimitError("queue", "the queue is full; try again later")
        if client and db.execute(sql.QUEUED_BY, (client,)).fetchone()["jobs"] >= max_own:
            raise LimitError("own_queue", f"you already have {max_own} jobs waiting; try again later")

    def _check_quotas(self, db: Database, owner: str | None, size_bytes: int) -> None:
        quota, own_quota = self._settings.quota_bytes, self._settings.quota_bytes_per_key
        if owner and own_quota and tallies.stored_bytes(db, owner) + size_bytes > own_quota:
            raise LimitError("own_quota", "this API key has reached its storage quota; remove jobs first")
        if quota and tallies.stored_bytes(db) + size_bytes > quota:
            raise LimitError("quota", "the service has reached its storage quota; remove jobs first")

    def get(self, job_id: str, owner: str | None = None) -> Job | None:
        """Return the job with this id, else None; with an owner, only if it is theirs."""
        found = self._found("WHERE id = ? AND owner = coalesce(?, owner)", job_id, owner, 1)
        return found[0] if found else None

    def position(self, job: Job) -> int:
        """Return the place of a queued job, from 1, ignoring that owners take turns."""
        with self._connection() as db:
            return int(db.execute(sql.POSITION, (job.priority, job.priority, job.number)).fetchone()["position"])

    def queued(self) -> int:
        with self._connection() as db:
            return int(db.execute(sql.QUEUED).fetchone()["jobs"])

    def counts(self) -> Counts:
        with self._connection() as db:
            counted, stored_bytes = tallies.by_state(db)
            figures = db.execute(sql.COUNTS).fetchone()
            seen = db.execute(sql.SEEN).fetchall()
            so_far = tallies.totals(db)
        return Counts(
            jobs={state: counted.get(state, 0) for state in JOB_STATES},
            workers={row["name"]: row["seconds"] for row in seen},
            totals=so_far,
            stored_bytes=stored_bytes,
            **dict(figures),
        )

    def page(
        self, limit: int, before: int | None = None, owner: str | None = None, state: JobState | None = None
    ) -> list[Job]:
        """Return the newest jobs, newest first, filtered by number below `before`, owner and state."""
        conditions: dict[str, Any] = {"number < ?": before, "owner = ?": owner, "state = ?": state}
        chosen = {condition: value for condition, value in conditions.items() if value is not None}
        where = f"WHERE {' AND '.join(chosen)}" if chosen else ""
        return self._found(where, *chosen.values(), limit)

    def _found(self, where: str, *values: Any) -> list[Job]:
        """Return the newest jobs, newest first. values: of `where`, and how many jobs."""
        with self._connection() as db:
            rows = db.execute(f"SELECT * FROM jobs {where} ORDER BY number DESC LIMIT ?", values)
            return [job_of(row) for row in rows.fetchall()]

    def trace(self, job_id: str) -> list[dict[str, Any]]:
        """Return the trace points of the job's latest attempt, oldest first."""
        query = "SELECT point FROM trace JOIN jobs ON number = job WHERE id = ? ORDER BY place"
        with self._connection() as db:
            return [json.loads(row["point"]) for row in db.execute(query, (job_id,)).fetchall()]

    def remove(self, job_id: str) -> Job | None:
        """Delete a job in any state, and return it. A worker that runs it loses its claim."""
        with self._transaction() as db:
            row = db.execute("DELETE FROM jobs WHERE id = ? RETURNING *", (job_id,)).fetchone()
            if row is not None and row["state"] not in FINAL_STATES:
                tallies.count(db, "cancelled")
        return None if row is None else job_of(row)

    def retry(self, job_id: str) -> bool:
        """Put a failed job back into the queue, as if it had never run. False: it has not failed, or has no image."""
        with self._transaction() as db:
            return _update(db, sql.RETRY, sql.RETRIED, job_id) is not None

    def reconcile(self) -> list[Job]:
        """Requeue running jobs whose worker is lost; those that lost too many fail. Returns the jobs that failed.

        A worker is lost when its lease has ended and this object has watched it stay silent for a while longer, so call
        this repeatedly.
        """
        lost = self._lost_claims()
        if not lost:
            return []
        with self._transaction() as db:
            jobs = [self._fail(db, WORKER_LOST, sql.LOST, claim) for claim in lost]
        return [job for job in jobs if job is not None and job.state == "failed"]

    def _lost_claims(self) -> list[tuple[str, int, float]]:
        """Return claims that are overdue, and have been watched for half of a lease.

        One look is not enough: clocks jump, and after a database outage every lease is over. A live worker renews its
        own meanwhile.
        """
        watched_s = WATCHED * self._settings.lease_s
        query = f"SELECT id, attempt, lease_until FROM jobs {sql.OVERDUE}"
        with self._connection() as db:
            rows = db.execute(query, (watched_s, self._settings.lease_s)).fetchall()
        now = time.monotonic()
        claims = [(row["id"], row["attempt"], row["lease_until"]) for row in rows]
        self._overdue = {claim: self._overdue.get(claim, now) for claim in claims}
        return [claim for claim, since in self._overdue.items() if now - since >= watched_s]

    def claim(self, worker: str) -> Job | None:
        """Claim the next queued job for a worker (a name for operators); None if there is none.

        Interactive jobs come before bulk jobs; among equals the owner with the fewest running jobs, then the owner
        served longest ago, then the oldest job.
        """
        if self.queued() == 0:  # called several times a second, so check before taking a lock
            return None
        with self._transaction(alone=True) as db:
            row = db.execute(sql.CLAIM, (worker, self._settings.lease_s)).fetchone()
            if row is None:
                return None
            db.execute(sql.SERVED, (row["number"],))
            db.execute("DELETE FROM trace WHERE job = ?", (row["number"],))
        return job_of(row)

    def register(self, worker: str) -> None:
        """Note that the worker is alive, with or without a job."""
        with self._transaction() as db:
            db.execute(sql.REGISTER, (worker,))
            db.execute("DELETE FROM workers WHERE seen_at < epoch() - ?", (FORGET_AFTER_S,))

    def unregister(self, worker: str) -> None:
        """Forget a worker that has stopped on request."""
        with self._transaction() as db:
            db.execute("DELETE FROM workers WHERE name = ?", (worker,))

    def heartbeat(self, claim: Job, points: Sequence[JsonObject], first: int) -> bool:
        """Renew the lease and append trace points from index `first`. False: the job is no longer this worker's."""
        with self._transaction() as db:
            is_ours = self._change(db, claim, "lease_until = epoch() + ?", self._settings.lease_s) is not None
            for place, point in enumerate(points if is_ours else (), first):
                db.execute(sql.TRACE_POINT, (place, json.dumps(point), claim.id))
            return is_ours

    def finish(self, claim: Job, result: EncodeResult) -> bool:
        """Publish the result. The call may be repeated. False: the job is no longer this worker's."""
        text = as_json(result)
        with self._transaction() as db:
            job = self._change(db, claim, sql.DONE, text, result.size_bytes, int(self.keeps_sources))
            if job is not None:
                tallies.conclude(db, job)
                return True
            # A commit that succeeded may be reported as failed; then the repeated call must succeed.
            done = "SELECT 1 FROM jobs WHERE id = ? AND attempt = ? AND result = ?"
            return db.execute(done, (claim.id, claim.attempt, text)).fetchone() is not None

    def fail(self, claim: Job, error: JobError) -> bool:
        """End an attempt in failure, for good unless it crashed fewer than MAX_ATTEMPTS times.

        False: the job is no longer this worker's.
        """
        with self._transaction() as db:
            return self._fail(db, error, sql.CLAIMED, (claim.id, claim.attempt)) is not None

    def _fail(self, db: Database, error: JobError, where: str, values: Sequence[Any]) -> Job | None:
        """Return the job after an attempt that failed; None if the attempt is not its latest."""
        lost = error in (WORKER_LOST, *PUT_OFF)
        crashed, put_off_s = error.code == "crashed" and not lost, sql.PUT_OFF_S if error in PUT_OFF else None
        job = _update(db, sql.PUT_BACK, where, as_json(error), int(crashed), int(lost), put_off_s, *values)
        again = (crashed or lost) and job is not None and job.crashes < MAX_ATTEMPTS and job.losses < MAX_LOSSES
        if job is not None and not again:
            job = _update(db, sql.FAIL, "WHERE id = ?", int(self.keeps_sources), job.id)
        if job is not None:
            tallies.conclude(db, job, put_off=again and error == IMAGE_LOST)
        return job

    @property
    def keeps_sources(self) -> bool:
        """Whether the images of finished jobs are kept, and so count as stored."""
        return self._settings.source_retention_s > 0

    def release(self, claim: Job, put_off_s: float | None = None) -> bool:
        """Return the job to its place in the queue, after put_off_s seconds. False: it is no longer this worker's."""
        with self._transaction() as db:
            return self._change(db, claim, sql.RELEASE, put_off_s) is not None

    @staticmethod
    def _change(db: Database, claim: Job, assignments: str, *values: Any) -> Job | None:
        """Update the claimed job under its fencing token; None if the token is stale."""
        return _update(db, assignments, sql.CLAIMED, *values, claim.id, claim.attempt)

    def made_at(self) -> float:
        """Return when the table was made."""
        with self._connection() as db:
            return float(db.execute("SELECT amount FROM totals WHERE name = 'made_at'").fetchone()["amount"])

    def unneeded(self, keys: Iterable[str]) -> Iterator[str]:
        """Yield those of the storage keys that no job needs."""
        rest = iter(keys)
        while batch := list(islice(rest, KEYS_AT_ONCE)):
            with self._connection() as db:
                unneeded = tallies.unneeded(db, batch)
            yield from unneeded

    def source_removed(self, job_id: str) -> None:
        """Stop counting the deleted image of a finished job as stored."""
        with self._transaction() as db:
            _update(db, "image_bytes = 0", "WHERE id = ? AND state IN ('done', 'failed')", job_id)

    def finished(self, older_than_s: float, *, with_image: bool = False) -> list[str]:
        """Return ids of jobs that ended so long ago, oldest first. with_image: only those whose image is kept."""
        ended = "state IN ('done', 'failed') AND finished_at < epoch() - ? AND image_bytes >= ?"
        with self._connection() as db:
            rows = db.execute(f"SELECT id FROM jobs WHERE {ended} ORDER BY number", (older_than_s, int(with_image)))
            return [row["id"] for row in rows.fetchall()]


def _update(db: Database, assignments: str, where: str, *values: Any) -> Job | None:
    """Return the job after an update, or None if no job matches."""
    row = db.execute(f"UPDATE jobs SET {assignments} {where} RETURNING *", values).fetchone()
    return None if row is None else job_of(row)


def _first(db: Database, owner: str | None, idempotency_key: str | None, fingerprint: str | None = None) -> Job | None:
    """Return the owner's job with this key; each owner has their own keys."""
    query = "SELECT * FROM jobs WHERE owner = ? AND idempotency_key = ?"
    row = db.execute(query, (owner or "", idempotency_key)).fetchone()
    if row is not None and fingerprint not in (None, row["fingerprint"]):
        raise KeyReusedError("this Idempotency-Key was already used for a different request")
    return None if row is None else job_of(row)
