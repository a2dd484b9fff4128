"""What every job table must do."""

from __future__ import annotations

import multiprocessing
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from service.jobs import (
    BackendError,
    Census,
    Claim,
    EncodeRequest,
    EncodeResult,
    JobBackend,
    JobError,
    JobRules,
    KeyReusedError,
    NewJob,
    OwnQueueFullError,
    QueueFullError,
    SourceImage,
    new_job_id,
)
from service.postgres_jobs import PostgresJobs
from service.sqlite_jobs import SqliteJobs
from service.storage import bitstream_key, source_key

REQUEST = EncodeRequest("bpp", 0.3, "paper", 60.0)
IMAGE = SourceImage("PNG", 64, 48, 1000)
RESULT = EncodeResult("bitstreams/x.1.sg", "ab" * 32, {"bytes": 100, "psnr": None})
CRASH = JobError("crashed", "it crashed")
LONG_S, NO_TIME_S = 60.0, 0.0
RULES = JobRules(LONG_S, 3)

OpenBackend = Callable[..., JobBackend]


@pytest.fixture
def open_backend(tmp_path: Path, database_url: str) -> Iterator[OpenBackend]:
    """Opens the same table with leases of so many seconds."""
    opened: list[JobBackend] = []

    def opener(lease_s: float, **options: int) -> JobBackend:
        opened.append(_open(database_url, tmp_path, lease_s, **options))
        return opened[-1]

    yield opener
    for backend in opened:
        backend.close()


@pytest.fixture
def backend(open_backend: OpenBackend) -> JobBackend:
    return open_backend(LONG_S)


def new(key: str | None = None, fingerprint: str = "f", **more: Any) -> NewJob:
    return NewJob(new_job_id(), REQUEST, IMAGE, fingerprint, key, **more)


def submitted(backend: JobBackend, **more: Any) -> str:
    return backend.submit(new(**more), 100)[0].id


def claimed(backend: JobBackend) -> Claim:
    claim = backend.claim("w")
    assert claim is not None
    return claim


def state(backend: JobBackend, job_id: str) -> str:
    job = backend.get(job_id)
    assert job is not None
    return job.state


def test_jobs_are_claimed_in_order_and_once(backend: JobBackend) -> None:
    ids = [submitted(backend) for _ in range(3)]
    claims = [claimed(backend) for _ in range(3)]
    assert [claim.job_id for claim in claims] == ids
    assert claims[0] == Claim(ids[0], 1, REQUEST)
    assert backend.claim("w") is None


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
    oldest = backend.submit(new(), 100)[0]
    submitted(backend)
    claim = claimed(backend)
    census = backend.census()
    assert census.jobs == {**nothing, "queued": 2, "running": 1}
    assert census.waiting_since == oldest.created_at
    running = backend.get(claim.job_id)
    assert running is not None
    assert census.worked_at == pytest.approx(running.started_at, abs=0.1)
    backend.heartbeat(claim, [], 0)
    heard_from = backend.census().worked_at
    assert heard_from > census.worked_at
    backend.finish(claim, RESULT)
    assert backend.census().worked_at == heard_from
    backend.fail(claimed(backend), JobError("refused", "no"), retry=False)
    assert backend.census().jobs == {"queued": 1, "running": 0, "done": 1, "failed": 1}


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


def test_interactive_jobs_come_before_bulk_jobs(backend: JobBackend) -> None:
    bulk, late_bulk = submitted(backend, priority="bulk"), submitted(backend, priority="bulk")
    urgent = submitted(backend)
    positions = {job.id: (job.position, job.priority) for job in backend.page(10)}
    assert positions == {urgent: (1, "interactive"), bulk: (2, "bulk"), late_bulk: (3, "bulk")}
    assert [claimed(backend).job_id for _ in range(3)] == [urgent, bulk, late_bulk]


def test_owners_take_turns(backend: JobBackend) -> None:
    """Who has the fewest running jobs is next, then who was served longest ago, then the oldest job."""
    of_anna = [submitted(backend, owner="anna") for _ in range(4)]
    of_bert = [submitted(backend, owner="bert") for _ in range(2)]
    of_cora = [submitted(backend, owner="cora")]
    first = claimed(backend)
    assert first.job_id == of_anna[0]
    assert [claimed(backend).job_id for _ in range(2)] == [of_bert[0], of_cora[0]]
    assert backend.finish(first, RESULT)  # anna has none running
    second = claimed(backend)
    assert second.job_id == of_anna[1]
    assert backend.finish(second, RESULT)
    third = claimed(backend)
    assert third.job_id == of_anna[2]
    # All have one running: bert was served before anna.
    assert [claimed(backend).job_id for _ in range(2)] == [of_bert[1], of_anna[3]]


def test_running_jobs_of_an_owner_are_limited(open_backend: OpenBackend) -> None:
    backend = open_backend(LONG_S, max_running_per_owner=1)
    first, second = [submitted(backend, owner="anna") for _ in range(2)]
    other = submitted(backend, owner="bert", priority="bulk")
    claim = claimed(backend)
    assert (claim.job_id, claimed(backend).job_id) == (first, other)
    assert backend.claim("w") is None
    assert state(backend, second) == "queued"
    assert backend.finish(claim, RESULT)
    assert claimed(backend).job_id == second


def test_position(backend: JobBackend) -> None:
    ids = [submitted(backend) for _ in range(3)]
    claimed(backend)
    positions = [job.position for job in reversed(backend.page(10))]
    assert positions == [None, 1, 2]
    backend.remove(ids[1])
    last = backend.get(ids[2])
    assert last is not None
    assert last.position == 1


def test_heartbeat_carries_the_trace(backend: JobBackend) -> None:
    job_id = submitted(backend)
    claim = claimed(backend)
    assert backend.heartbeat(claim, [{"step": 0}, {"step": 1}], 0)
    assert backend.heartbeat(claim, [], 2)
    assert backend.heartbeat(claim, [{"step": 1}, {"step": 2}], 1)  # a point that was sent twice
    assert backend.trace(job_id) == [{"step": 0}, {"step": 1}, {"step": 2}]
    assert backend.trace(job_id, 2) == [{"step": 2}]
    assert backend.trace(job_id, 3) == []
    assert backend.fail(claim, CRASH, retry=True)
    claimed(backend)
    assert backend.trace(job_id) == []


def test_finish(backend: JobBackend) -> None:
    job_id = submitted(backend)
    claim = claimed(backend)
    assert backend.finish(claim, RESULT)
    assert backend.finish(claim, RESULT)  # as after a commit whose answer was lost
    job = backend.get(job_id)
    assert job is not None
    assert (job.state, job.result, job.error) == ("done", RESULT, None)
    assert backend.live_keys() == {RESULT.bitstream_key}


def test_a_stale_claim_changes_nothing(open_backend: OpenBackend) -> None:
    """Rule 2: once the lease is over and another has claimed the job, the first worker's token is void."""
    hasty = open_backend(NO_TIME_S)
    job_id = submitted(hasty)
    stale = claimed(hasty)
    assert hasty.reconcile() == []
    fresh = claimed(open_backend(LONG_S))
    assert (fresh.job_id, fresh.attempt) == (job_id, 2)
    before = hasty.get(job_id)
    assert not hasty.heartbeat(stale, [{"step": 1}], 0)
    assert not hasty.finish(stale, RESULT)
    assert not hasty.fail(stale, CRASH, retry=True)
    assert not hasty.fail(stale, CRASH, retry=False)
    assert not hasty.release(stale)
    assert hasty.get(job_id) == before
    assert hasty.trace(job_id) == []
    assert hasty.finish(fresh, RESULT)
    assert not hasty.finish(stale, EncodeResult("bitstreams/x.9.sg", "cd" * 32, {}))


def test_a_removed_job_is_lost_to_its_worker(backend: JobBackend) -> None:
    job_id = submitted(backend)
    claim = claimed(backend)
    assert backend.heartbeat(claim, [{"step": 0}], 0)
    removed = backend.remove(job_id)
    assert removed is not None
    assert (removed.id, removed.state) == (job_id, "running")
    assert backend.remove(job_id) is None
    assert not backend.heartbeat(claim, [{"step": 1}], 1)
    assert not backend.finish(claim, RESULT)
    assert backend.trace(job_id) == []


def test_crashes_are_limited(backend: JobBackend) -> None:
    job_id = submitted(backend)
    for attempt in (1, 2):
        claim = claimed(backend)
        assert claim.attempt == attempt
        assert backend.fail(claim, CRASH, retry=True)
        assert state(backend, job_id) == "queued"
    assert backend.fail(claimed(backend), JobError("crashed", "the last one"), retry=True)
    job = backend.get(job_id)
    assert job is not None
    assert (job.state, job.crashes, job.error) == ("failed", 3, JobError("crashed", "the last one"))
    assert job.finished_at is not None
    assert backend.claim("w") is None


def test_a_refusal_is_final(backend: JobBackend) -> None:
    job_id = submitted(backend)
    assert backend.fail(claimed(backend), JobError("refused", "no"), retry=False)
    job = backend.get(job_id)
    assert job is not None
    assert (job.state, job.crashes, job.error) == ("failed", 0, JobError("refused", "no"))


def test_leases_that_are_over_count_as_crashes(open_backend: OpenBackend) -> None:
    hasty = open_backend(NO_TIME_S)
    job_id = submitted(hasty)
    for _ in range(2):
        claimed(hasty)
        assert hasty.reconcile() == []
        assert state(hasty, job_id) == "queued"
    claimed(hasty)
    assert [job.id for job in hasty.reconcile()] == [job_id]
    assert state(hasty, job_id) == "failed"


def test_a_live_lease_is_left_alone(open_backend: OpenBackend) -> None:
    hasty = open_backend(NO_TIME_S)
    job_id = submitted(hasty)
    claim = claimed(hasty)
    assert open_backend(LONG_S).heartbeat(claim, [], 0)
    assert hasty.reconcile() == []
    assert state(hasty, job_id) == "running"


def test_a_released_job_keeps_its_place_and_counts_no_crash(backend: JobBackend) -> None:
    first, second = submitted(backend), submitted(backend)
    assert backend.release(claimed(backend))
    again = claimed(backend)
    assert (again.job_id, again.attempt) == (first, 2)
    job = backend.get(first)
    assert job is not None
    assert job.crashes == 0
    assert claimed(backend).job_id == second


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


def _open(database_url: str, folder: Path, lease_s: float, **options: int) -> JobBackend:
    rules = JobRules(lease_s, 3, **options)
    return SqliteJobs(folder / "jobs.sqlite3", rules) if database_url == "sqlite" else PostgresJobs(database_url, rules)


def _claim_and_finish(database_url: str, folder: Path, ids: multiprocessing.SimpleQueue[str]) -> None:
    backend = _open(database_url, folder, LONG_S)
    while claim := backend.claim("w"):
        assert backend.heartbeat(claim, [{"step": 1}], 0)
        assert backend.finish(claim, RESULT)
        ids.put(claim.job_id)
    backend.close()


def _submit_and_close(database_url: str, folder: Path, ids: multiprocessing.SimpleQueue[str]) -> None:
    backend = _open(database_url, folder, LONG_S)
    ids.put(backend.submit(new("the same key"), 100)[0].id)
    backend.close()


def _all_of(target: Callable[..., None], number: int, *arguments: Any) -> list[Any]:
    """What so many processes that start together put into the queue they are given."""
    context = multiprocessing.get_context("spawn")
    said = context.SimpleQueue()
    processes = [context.Process(target=target, args=(*arguments, said)) for _ in range(number)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
        assert process.exitcode == 0
    heard = []
    while not said.empty():
        heard.append(said.get())
    return heard


def test_processes_share_a_table(database_url: str, tmp_path: Path) -> None:
    """No job goes to two of them."""
    first = _open(database_url, tmp_path, LONG_S)
    expected = {submitted(first) for _ in range(60)}
    first.close()
    seen = _all_of(_claim_and_finish, 4, database_url, tmp_path)
    assert len(seen) == len(expected)
    assert set(seen) == expected


def test_processes_open_a_table_that_none_has_made_yet(database_url: str, tmp_path: Path) -> None:
    """And all submit under one key: one job comes of it."""
    ids = _all_of(_submit_and_close, 4, database_url, tmp_path)
    assert (len(ids), len(set(ids))) == (4, 1)


def test_a_table_that_cannot_be_read(tmp_path: Path) -> None:
    path = tmp_path / "jobs.sqlite3"
    path.write_bytes(b"this is not a database" * 100)
    with pytest.raises(BackendError, match="not a database"):
        SqliteJobs(path, RULES)


def test_a_table_of_a_later_version(tmp_path: Path) -> None:
    path = tmp_path / "jobs.sqlite3"
    SqliteJobs(path, RULES).close()
    database = sqlite3.connect(path)
    database.execute("PRAGMA user_version = 99")
    database.close()
    with pytest.raises(BackendError, match="newer"):
        SqliteJobs(path, RULES)


def test_a_table_of_version_1_is_brought_up_to_date(tmp_path: Path) -> None:
    path = tmp_path / "jobs.sqlite3"
    database = sqlite3.connect(path)
    database.executescript((Path(__file__).parent / "jobs_version_1.sql").read_text())
    database.close()
    for _ in range(2):  # the second time there is nothing left to do
        backend = SqliteJobs(path, RULES)
        waiting, done = backend.page(10)
        assert (waiting.number, waiting.state, waiting.owner, waiting.priority) == (7, "queued", None, "interactive")
        assert (done.number, done.state, done.result) == (5, "done", RESULT)
        assert backend.trace(done.id) == [{"step": 0}, {"step": 1}]
        assert backend.find_key("key") == waiting
        backend.close()
    database = sqlite3.connect(path)
    tables = {name for (name,) in database.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")}
    database.close()
    assert tables == {"jobs", "trace", "served", "sqlite_sequence"}


def test_durability_settings(tmp_path: Path) -> None:
    """Rule 6."""
    backend = SqliteJobs(tmp_path / "jobs.sqlite3", RULES)
    with backend._connection() as db:
        values = {
            name: db.execute(f"PRAGMA {name}").fetchone()[0]
            for name in ("journal_mode", "synchronous", "foreign_keys", "busy_timeout")
        }
    assert values == {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1, "busy_timeout": 30_000}
    backend.close()
