"""What every job table does: which worker runs which job when, whose report counts, and what is counted."""

from __future__ import annotations

import multiprocessing
from contextlib import closing
from pathlib import Path

import pytest

from service.errors import LimitError
from service.jobs import table as table_module
from service.jobs.job import EncodeRequest, EncodeResult, new_job_id
from service.jobs.table import MAX_ATTEMPTS, MAX_LOSSES, NO_PROCESSOR, JobTable
from service.jobs.tallies import ENCODING, OUTCOMES, QUEUEING
from service.storage.files import source_key
from tests.support.job_table import (
    CRASH,
    IMAGE,
    LONG_S,
    NO_TIME_S,
    REFUSED,
    REQUEST,
    RESULT,
    OpenTable,
    change,
    claimed,
    grow_older,
    job_of,
    new,
    open_table,
    state,
    submitted,
    what_all_say,
)


def test_interactive_jobs_come_before_bulk_jobs(table: JobTable) -> None:
    bulk, late_bulk = submitted(table, priority="bulk"), submitted(table, priority="bulk")
    urgent = submitted(table)
    assert [table.position(job_of(table, job_id)) for job_id in (urgent, bulk, late_bulk)] == [1, 2, 3]
    assert [claimed(table).id for _ in range(3)] == [urgent, bulk, late_bulk]
    assert table.claim("w") is None


def test_owners_take_turns(table: JobTable) -> None:
    """The owner with the fewest running jobs is next, then the one served longest ago, then the oldest job."""
    of_anna = [submitted(table, owner="anna") for _ in range(4)]
    of_bert = [submitted(table, owner="bert") for _ in range(2)]
    of_cora = [submitted(table, owner="cora")]
    first = claimed(table)
    assert (first.id, first.attempt, first.image) == (of_anna[0], 1, IMAGE)
    assert first.model_dump(include=set(EncodeRequest.model_fields)) == REQUEST.model_dump()
    assert [claimed(table).id for _ in range(2)] == [of_bert[0], of_cora[0]]
    assert table.finish(first, RESULT)  # anna has none running
    second = claimed(table)
    assert second.id == of_anna[1]
    assert table.finish(second, RESULT)
    third = claimed(table)
    assert third.id == of_anna[2]
    # All have one running: bert was served before anna.
    assert [claimed(table).id for _ in range(2)] == [of_bert[1], of_anna[3]]


def test_heartbeat_carries_the_trace(table: JobTable) -> None:
    job_id = submitted(table)
    claim = claimed(table)
    assert table.heartbeat(claim, [{"step": 0}, {"step": 1}], 0)
    assert table.heartbeat(claim, [], 2)
    assert table.heartbeat(claim, [{"step": 1}, {"step": 2}], 1)  # a point that was sent twice
    assert table.trace(job_id) == [{"step": 0}, {"step": 1}, {"step": 2}]
    assert table.fail(claim, CRASH)
    claimed(table)
    assert table.trace(job_id) == []


def test_the_error_of_a_crash_is_shown_once_the_job_has_failed(table: JobTable) -> None:
    job_id = submitted(table)
    for _ in range(MAX_ATTEMPTS):
        assert job_of(table, job_id).error is None
        assert table.fail(claimed(table), CRASH)
    assert job_of(table, job_id).error == CRASH


def test_a_stale_claim_changes_nothing(open_job_table: OpenTable) -> None:
    """Rule 2: once the lease is over and another has claimed the job, the first worker's token is void."""
    hasty = open_job_table(NO_TIME_S)
    job_id = submitted(hasty)
    stale = claimed(hasty)
    assert hasty.reconcile() == []
    fresh = claimed(open_job_table(LONG_S))
    assert (fresh.id, fresh.attempt) == (job_id, 2)
    before = hasty.get(job_id)
    assert not hasty.heartbeat(stale, [{"step": 1}], 0)
    assert not hasty.finish(stale, RESULT)
    assert not hasty.fail(stale, CRASH)
    assert not hasty.fail(stale, REFUSED)
    assert not hasty.release(stale)
    assert hasty.get(job_id) == before
    assert hasty.trace(job_id) == []
    assert hasty.finish(fresh, RESULT)
    for result in (RESULT, EncodeResult("cd" * 32, {})):
        assert not hasty.finish(stale, result)


def test_a_lost_worker_is_no_crash_of_its_job(open_job_table: OpenTable) -> None:
    """Four restarts of a machine failed a job for good. What loses its worker again and again ends all the same."""
    hasty = open_job_table(NO_TIME_S)
    job_id = submitted(hasty)
    for lost in range(1, MAX_LOSSES):
        claimed(hasty)
        assert hasty.reconcile() == []
        job = job_of(hasty, job_id)
        assert (job.state, job.crashes, job.losses) == ("queued", 0, lost)
    claimed(hasty)
    assert [job.id for job in hasty.reconcile()] == [job_id]
    assert state(hasty, job_id) == "failed"


def test_a_machine_that_is_too_busy_fails_no_job(table: JobTable) -> None:
    """It failed a job for good. Others go first, and the job is tried again as after a lost worker."""
    job_id, other = submitted(table), submitted(table)
    assert table.fail(claimed(table), NO_PROCESSOR)
    job = job_of(table, job_id)
    assert (job.state, job.crashes, job.losses, job.error) == ("queued", 0, 1, None)
    assert claimed(table).id == other
    assert table.claim("w") is None  # until it is due
    change(table, "UPDATE jobs SET lease_until = 0 WHERE id = ?", job_id)
    assert claimed(table).id == job_id
    assert table.counts().totals["retried"] == 1


@pytest.mark.parametrize("lives", [True, False])
@pytest.mark.parametrize("jump_s", [1000.0, 0.0, -1000.0])
def test_a_clock_that_jumps(
    open_job_table: OpenTable, monkeypatch: pytest.MonkeyPatch, jump_s: float, lives: bool
) -> None:
    """It costs no job, nor does an outage, after which every lease is over: a live worker has renewed it by the
    second look. And a dead worker is noticed even if its lease lies far in the future by now.
    """
    table = open_job_table(LONG_S)
    submitted(table)
    claim = claimed(table)
    change(table, "UPDATE jobs SET lease_until = lease_until - ?", jump_s)
    assert table.reconcile() == []
    assert state(table, claim.id) == "running"
    if lives:
        assert table.heartbeat(claim, [], 0)
    later = table_module.time.monotonic() + (LONG_S if jump_s else 10 * LONG_S)
    monkeypatch.setattr(table_module.time, "monotonic", lambda: later)  # for the watcher of leases alone
    assert table.reconcile() == []
    job = job_of(table, claim.id)
    expected = ("running", 0) if lives or not jump_s else ("queued", 1)
    assert (job.state, job.losses) == expected


def test_a_released_job_keeps_its_place_and_counts_no_crash(table: JobTable) -> None:
    first, second = submitted(table), submitted(table)
    assert table.release(claimed(table))
    again = claimed(table)
    assert (again.id, again.attempt) == (first, 2)
    assert job_of(table, first).crashes == 0
    assert claimed(table).id == second
    assert table.release(again, put_off_s=LONG_S)
    assert table.claim("w") is None
    grow_older(table, LONG_S)
    assert claimed(table).id == first


def claim_and_finish(database_url: str, folder: Path, ids: multiprocessing.SimpleQueue[str]) -> None:
    with closing(open_table(database_url, folder, LONG_S)) as table:
        while claim := table.claim("w"):
            assert table.heartbeat(claim, [{"step": 1}], 0)
            assert table.finish(claim, RESULT)
            ids.put(claim.id)


@pytest.mark.thorough
def test_processes_share_a_table(database_url: str, tmp_path: Path) -> None:
    """No job goes to two of them."""
    with closing(open_table(database_url, tmp_path, LONG_S)) as table:
        expected = [submitted(table) for _ in range(60)]
    assert sorted(what_all_say(claim_and_finish, 4, database_url, tmp_path)) == sorted(expected)


def test_one_client_fills_half_of_the_queue(open_job_table: OpenTable) -> None:
    """And is not remembered once its jobs no longer wait."""
    table = open_job_table(LONG_S, queue_length=3)
    submitted(table, client="192.0.2.1")
    table.check_queue("192.0.2.1")
    submitted(table, client="192.0.2.1")
    for refused in (lambda: table.submit(new(client="192.0.2.1")), lambda: table.check_queue("192.0.2.1")):
        with pytest.raises(LimitError, match="2 jobs") as refusal:
            refused()
        assert refusal.value.reason == "own_queue"
    submitted(table, client="192.0.2.2")
    claimed(table)
    table.check_queue("192.0.2.1")
    with table._connection() as db:
        rows = db.execute("SELECT client FROM jobs ORDER BY number").fetchall()
    assert [row["client"] for row in rows] == ["", "192.0.2.1", "192.0.2.2"]


def test_queue_length_counts_waiting_jobs_only(open_job_table: OpenTable) -> None:
    table = open_job_table(LONG_S, queue_length=1)
    table.submit(new("key"))
    for refused in (lambda: table.submit(new()), table.check_queue, lambda: table.check_queue("key ann", "ann", "key")):
        with pytest.raises(LimitError) as refusal:
            refused()
        assert refusal.value.reason == "queue"
    table.check_queue(idempotency_key="key")  # which makes no new job
    claimed(table)
    table.submit(new())
    assert table.queued() == 1


def test_signs_of_life(table: JobTable, monkeypatch: pytest.MonkeyPatch) -> None:
    for worker in ("one", "two", "one"):
        table.register(worker)
    workers = table.counts().workers
    assert sorted(workers) == ["one", "two"]
    assert all(-1 < seconds < 60 for seconds in workers.values())
    table.unregister("two")
    assert list(table.counts().workers) == ["one"]
    monkeypatch.setattr(table_module, "FORGET_AFTER_S", -60)
    table.register("three")  # and workers that were silent for too long are forgotten
    assert table.counts().workers == {}


def submit_once(database_url: str, folder: Path, ids: multiprocessing.SimpleQueue[str]) -> None:
    with closing(open_table(database_url, folder, LONG_S)) as table:
        ids.put(table.submit(new("the same key"))[0].id)


def test_processes_open_a_table_that_none_has_made_yet(database_url: str, tmp_path: Path) -> None:
    """And all submit under one key: it is one job."""
    ids = what_all_say(submit_once, 4, database_url, tmp_path)
    assert (len(ids), len(set(ids))) == (4, 1)


@pytest.mark.parametrize("kept_s", [0.0, LONG_S])
def test_bytes_are_counted_as_long_as_they_are_kept(open_job_table: OpenTable, kept_s: float) -> None:
    """Of images of finished jobs too, where those are kept."""
    table = open_job_table(LONG_S, source_retention_s=kept_s)
    done, failed, crashing = (table.submit(new(owner="ann"))[0] for _ in range(3))
    size = done.image.bytes
    kept = size if kept_s else 0
    assert table.counts().stored_bytes == 3 * size
    claims = {claim.id: claim for claim in (claimed(table) for _ in range(3))}
    for _ in range(2):  # as after a commit whose answer was lost
        assert table.finish(claims[done.id], EncodeResult("0" * 64, {"bytes": 7}))
    table.fail(claims[failed.id], REFUSED)
    assert table.counts().stored_bytes == size + 7 + 2 * kept
    table.fail(claims[crashing.id], CRASH)
    assert table.counts().stored_bytes == size + 7 + 2 * kept  # it is tried again
    while (claim := table.claim("w")) is not None:
        table.fail(claim, CRASH)
    assert table.counts().stored_bytes == 7 + 3 * kept
    images = [source_key(job.id) for job in (done, failed, crashing)]
    assert list(table.unneeded(images)) == ([] if kept else images)
    for job in (done, done, failed, crashing):
        table.source_removed(job.id)
    assert (table.counts().stored_bytes, list(table.unneeded(images))) == (7, images)
    table.source_removed(table.submit(new())[0].id)  # which waits
    assert table.counts().stored_bytes == 7 + size
    table.remove(done.id)
    assert table.counts().stored_bytes == size


def test_what_became_of_jobs_is_counted(table: JobTable) -> None:
    """Whether or not the jobs are still there."""
    done, crashed, refused, cancelled = (submitted(table) for _ in range(4))
    claim = claimed(table)
    for _ in range(2):  # once more, as after an answer that was lost
        assert table.finish(claim, RESULT)
    for _ in range(MAX_ATTEMPTS):
        assert table.fail(claimed(table), CRASH)
    assert table.fail(claimed(table), REFUSED)
    for job_id in (done, crashed, refused, cancelled):
        table.remove(job_id)
    totals = table.counts().totals
    counted = {"finished": 1, "retried": MAX_ATTEMPTS - 1, "put_off": 0, "failed": 2, "cancelled": 1}
    assert {name: totals.get(name, 0) for name in OUTCOMES} == counted
    for name, number in ((ENCODING, 1), (QUEUEING, 3)):
        assert totals[f"{name}_sum"] >= 0
        assert totals[f"{name}_count"] == number


def test_jobs_are_counted_whoever_changes_them(table: JobTable) -> None:
    """Many at once, too: a move to another database copies all of them."""
    number = 20
    for owner in ("ann", "bob"):
        submitted(table, owner=owner)
        claim = claimed(table)
        assert table.finish(claim, RESULT)
    names = "owner, state, fingerprint, request, image, created_at, finished_at, result, image_bytes, file_bytes"
    change(
        table,
        f"INSERT INTO jobs (id, {names}) WITH RECURSIVE numbers AS (SELECT 1 AS n UNION ALL SELECT n + 1 FROM numbers"
        f" WHERE n < ?) SELECT CAST(n AS TEXT), {names} FROM numbers, jobs WHERE owner = 'ann'",
        number,
    )
    size = RESULT.size_bytes
    assert table.counts().jobs == {"queued": 0, "running": 0, "done": number + 2, "failed": 0}
    assert table.counts().stored_bytes == (number + 2) * size
    change(table, "UPDATE jobs SET state = 'failed', result = NULL, file_bytes = 1 WHERE owner = 'ann'")
    assert table.counts().jobs == {"queued": 0, "running": 0, "done": 1, "failed": number + 1}
    assert table.counts().stored_bytes == size + number + 1
    change(table, "DELETE FROM jobs WHERE owner = 'ann'")
    assert (table.counts().stored_bytes, table.counts().jobs["failed"]) == (size, 0)


def test_quotas(open_job_table: OpenTable) -> None:
    size = new().image.bytes

    def refused(owner: str, **quotas: int) -> str:
        with pytest.raises(LimitError, match="remove jobs first") as refusal:
            open_job_table(LONG_S, **quotas).submit(new(owner=owner))
        return refusal.value.reason

    own = open_job_table(LONG_S, quota_bytes_per_key=size)
    submitted(own, owner="ann")
    assert refused("ann", quota_bytes_per_key=2 * size - 1) == "own_quota"
    submitted(own, owner="bob")
    assert refused("cat", quota_bytes=3 * size - 1, quota_bytes_per_key=size) == "quota"
    submitted(open_job_table(LONG_S, quota_bytes=3 * size, quota_bytes_per_key=size), owner="cat")


@pytest.mark.parametrize("kept_s", [0.0, LONG_S])
def test_a_failed_job_is_put_back(open_job_table: OpenTable, kept_s: float) -> None:
    """As if it had never run, while its image is kept. No other job is."""
    table = open_job_table(LONG_S, source_retention_s=kept_s)
    failed, waits = submitted(table), submitted(table)
    for _ in range(MAX_ATTEMPTS):
        assert not table.retry(failed)
        table.fail(claimed(table), CRASH)
    assert state(table, failed) == "failed"
    assert [table.retry(job_id) for job_id in (failed, waits, new_job_id())] == [bool(kept_s), False, False]
    if kept_s:
        job = job_of(table, failed)
        assert (job.state, job.error, job.crashes, job.finished_at) == ("queued", None, 0, None)
        assert (table.counts().jobs["queued"], table.counts().jobs["failed"]) == (2, 0)
        assert claimed(table).id == failed  # the oldest
        table.finish(claimed(table), RESULT)
        assert [table.retry(job_id) for job_id in (failed, waits)] == [False, False]
