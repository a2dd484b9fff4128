"""What every job table must do with jobs, but for running them."""

from __future__ import annotations

import multiprocessing
from pathlib import Path

import pytest

from service.jobs.interface import (
    Census,
    JobBackend,
    JobError,
    KeyReusedError,
    OwnQueueFullError,
    QueueFullError,
    new_job_id,
)
from service.jobs.sql import SqlJobs
from service.storage.disk import bitstream_key, source_key
from tests.harness.job_table import (
    CRASH,
    IMAGE,
    LONG_S,
    REQUEST,
    RESULT,
    claimed,
    new,
    open_table,
    submitted,
    what_all_say,
)


def test_a_job_is_what_was_submitted(backend: JobBackend) -> None:
    wanted = new("key")
    job, accepted = backend.submit(wanted, 100)
    assert accepted
    assert (job.id, job.request, job.image, job.state, job.attempt) == (
        wanted.id,
        REQUEST,
        IMAGE,
        "queued",
        0,
    )
    assert backend.get(wanted.id) == backend.find_key("key") == job
    assert backend.get(new_job_id()) is None
    assert backend.find_key("other") is None


def test_queue_length_counts_waiting_jobs_only(backend: JobBackend) -> None:
    backend.submit(new(), 1)
    with pytest.raises(QueueFullError):
        backend.submit(new(), 1)
    claimed(backend)
    backend.submit(new(), 1)
    assert backend.queued() == 1


def test_one_owner_cannot_fill_the_queue(backend: JobBackend) -> None:
    first = submitted(backend, owner="ann")
    with pytest.raises(OwnQueueFullError):
        backend.submit(new(owner="ann"), 100, 1)
    submitted(backend, owner="bob")
    assert (backend.queued(), backend.queued("ann"), backend.queued("eve")) == (2, 1, 0)
    with pytest.raises(OwnQueueFullError):
        backend.submit(new(owner="bob"), 100, 1)
    backend.remove(first)
    backend.submit(new(owner="ann"), 100, 1)
    backend.submit(new(owner="ann"), 100, 0)  # no limit


def test_census(backend: JobBackend) -> None:
    nothing = {"queued": 0, "running": 0, "done": 0, "failed": 0}
    assert backend.census() == Census(nothing, None, None)
    submitted(backend)
    submitted(backend)
    submitted(backend)
    claim = claimed(backend)
    grow_older(backend, 100)
    submitted(backend)
    census = backend.census()
    assert census.jobs == {**nothing, "queued": 3, "running": 1}
    assert census.waiting_s == pytest.approx(100, abs=5)
    assert census.silent_s == pytest.approx(100, abs=5)
    backend.heartbeat(claim, [], 0)
    assert backend.census().silent_s == pytest.approx(0, abs=5)
    backend.finish(claim, RESULT)
    grow_older(backend, 10)
    assert backend.census().silent_s == pytest.approx(10, abs=5)
    backend.fail(claimed(backend), JobError("refused", "no"), retry=False)
    assert backend.census().jobs == {"queued": 2, "running": 0, "done": 1, "failed": 1}


def grow_older(backend: JobBackend, seconds: float) -> None:
    """Let so much time have passed since all that was written."""
    assert isinstance(backend, SqlJobs)
    with backend._transaction() as db:
        db.execute("UPDATE jobs SET created_at = created_at - ?, lease_until = lease_until - ?", (seconds, seconds))
        db.execute("UPDATE served SET at = at - ?", (seconds,))


def test_idempotency_key(backend: JobBackend) -> None:
    first, accepted = backend.submit(new("key"), 1)
    assert accepted
    assert backend.submit(new("key"), 1) == (first, False)  # though the queue is full
    with pytest.raises(KeyReusedError):
        backend.submit(new("key", fingerprint="other"), 100)


def test_idempotency_keys_are_their_owners_alone(backend: JobBackend) -> None:
    mine, _ = backend.submit(new("key", owner="anna"), 100)
    theirs, accepted = backend.submit(new("key", owner="bert"), 100)
    assert accepted
    assert backend.find_key("key", "anna") == mine
    assert backend.get(theirs.id) == theirs
    assert backend.find_key("key", "bert") == backend.get(theirs.id)
    assert backend.find_key("key") is None


def test_owners(backend: JobBackend) -> None:
    of_anna, of_bert, of_nobody = submitted(backend, owner="anna"), submitted(backend, owner="bert"), submitted(backend)
    assert [job.id for job in backend.page(10, owner="anna")] == [of_anna]
    assert [(job.id, job.owner) for job in backend.page(10)] == [
        (of_nobody, None),
        (of_bert, "bert"),
        (of_anna, "anna"),
    ]
    assert backend.get(of_anna, "bert") is None
    mine = backend.get(of_anna, "anna")
    assert mine is not None
    assert mine.owner == "anna"
    assert backend.get(of_nobody, "anna") is None


def test_position(backend: JobBackend) -> None:
    ids = [submitted(backend) for _ in range(3)]
    claimed(backend)
    positions = [job.position for job in reversed(backend.page(10))]
    assert positions == [None, 1, 2]
    backend.remove(ids[1])
    last = backend.get(ids[2])
    assert last is not None
    assert last.position == 1


def test_pages(backend: JobBackend) -> None:
    ids = [submitted(backend) for _ in range(5)]
    newest = backend.page(2)
    assert [job.id for job in newest] == [ids[4], ids[3]]
    assert [job.id for job in backend.page(10, newest[-1].number)] == ids[2::-1]


def test_live_keys(backend: JobBackend) -> None:
    waiting, failed = submitted(backend), submitted(backend)
    claim = claimed(backend)
    unpublished = bitstream_key(claim.job_id, 1)
    assert backend.live_keys() == {source_key(waiting), source_key(failed), unpublished}
    assert backend.release(claim)
    backend.remove(waiting)
    assert backend.fail(claimed(backend), CRASH, retry=False)
    assert backend.live_keys() == set()


def test_finished_jobs(backend: JobBackend) -> None:
    ids = [submitted(backend) for _ in range(4)]
    assert backend.finish(claimed(backend), RESULT)
    assert backend.fail(claimed(backend), CRASH, retry=False)
    claimed(backend)
    assert [job.id for job in backend.finished(-1.0)] == ids[:2]
    assert backend.finished(60.0) == []


def _submit_and_close(database_url: str, folder: Path, ids: multiprocessing.SimpleQueue[str]) -> None:
    backend = open_table(database_url, folder, LONG_S)
    ids.put(backend.submit(new("the same key"), 100)[0].id)
    backend.close()


def test_processes_open_a_table_that_none_has_made_yet(database_url: str, tmp_path: Path) -> None:
    """And all submit under one key: one job comes of it."""
    ids = what_all_say(_submit_and_close, 4, database_url, tmp_path)
    assert (len(ids), len(set(ids))) == (4, 1)
