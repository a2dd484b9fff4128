"""What every job table must do with jobs, but for running them."""

from __future__ import annotations

import multiprocessing
from functools import partial
from pathlib import Path

import pytest

from service.jobs import table as table_module
from service.jobs.endings import BUCKETS_S, ENDINGS, SECONDS, bucket
from service.jobs.job import (
    Census,
    Claim,
    EncodeResult,
    KeyReusedError,
    LimitError,
    new_job_id,
)
from service.jobs.table import JobTable
from service.storage.files import bitstream_key, source_key
from tests.harness.job_table import (
    CRASH,
    IMAGE,
    LONG_S,
    REFUSED,
    REQUEST,
    RESULT,
    OpenTable,
    claimed,
    job_of,
    new,
    open_table,
    submitted,
    what_all_say,
)


def test_a_job_is_what_was_submitted(table: JobTable) -> None:
    wanted = new("key")
    job, accepted = table.submit(wanted)
    assert accepted
    assert (job.id, job.request, job.image, job.state, job.attempt) == (wanted.id, REQUEST, IMAGE, "queued", 0)
    assert table.get(wanted.id) == job
    assert table.get(new_job_id()) is None


def test_queue_length_counts_waiting_jobs_only(open_job_table: OpenTable) -> None:
    table = open_job_table(LONG_S, queue_length=1)
    table.submit(new("key"))
    for refused in (lambda: table.submit(new()), table.check_queue, lambda: table.check_queue("ann", "key")):
        with pytest.raises(LimitError) as refusal:
            refused()
        assert refusal.value.reason == "queue"
    table.check_queue(idempotency_key="key")  # which makes no new job
    claimed(table)
    table.submit(new())
    assert table.queued() == 1


def test_one_owner_cannot_fill_the_queue(open_job_table: OpenTable) -> None:
    table = open_job_table(LONG_S, queue_length=100, own_queue_length=1)
    first = submitted(table, owner="ann")
    submitted(table, owner="bob")
    for owner in ("ann", "bob"):
        for refused in (lambda owner=owner: table.submit(new(owner=owner)), partial(table.check_queue, owner)):
            with pytest.raises(LimitError, match="already has 1 jobs waiting") as refusal:
                refused()
            assert refusal.value.reason == "own_queue"
    table.check_queue("eve")
    for _ in range(2):
        submitted(table)  # nobody's
    table.remove(first)
    submitted(table, owner="ann")
    submitted(open_job_table(LONG_S), owner="ann")  # without limits


def test_signs_of_life(table: JobTable, monkeypatch: pytest.MonkeyPatch) -> None:
    for failures, worker in enumerate(("one", "two", "one")):
        table.sign(worker, failures)
    workers = table.census().workers
    assert table.census().failures == {"one": 2, "two": 1}
    assert sorted(workers) == ["one", "two"]
    assert all(-1 < seconds < 60 for seconds in workers.values())
    table.sign_off("two")
    assert list(table.census().workers) == ["one"]
    monkeypatch.setattr(table_module, "FORGOTTEN_S", -60)
    table.sign("three")  # and workers that were silent for too long are forgotten
    assert table.census().workers == {}


def test_census(table: JobTable) -> None:
    nothing = {"queued": 0, "running": 0, "done": 0, "failed": 0}
    assert table.census() == Census(nothing, None, 0)
    submitted(table)
    submitted(table)
    submitted(table)
    claim = claimed(table)
    hours, minutes = 10_000, 100  # and what the test itself may take
    grow_older(table, hours)
    submitted(table)
    census = table.census()
    assert census.jobs == {**nothing, "queued": 3, "running": 1}
    assert census.waiting_s == pytest.approx(hours, abs=minutes)
    assert census.silent_s is None
    for worker, silent_s in (("one", 2 * hours), ("two", hours)):
        table.sign(worker)
        with table._transaction() as db:
            db.execute("UPDATE workers SET seen_at = seen_at - ? WHERE name = ?", (silent_s, worker))
    assert table.census().silent_s == pytest.approx(hours, abs=minutes)
    table.finish(claim, RESULT)
    table.fail(claimed(table), REFUSED)
    assert table.census().jobs == {"queued": 2, "running": 0, "done": 1, "failed": 1}


def grow_older(table: JobTable, seconds: float) -> None:
    """Let so much time have passed since all that was written of jobs."""
    with table._transaction() as db:
        db.execute("UPDATE jobs SET created_at = created_at - ?, lease_until = lease_until - ?", (seconds, seconds))


def test_idempotency_keys_are_their_owners_alone(open_job_table: OpenTable) -> None:
    table = open_job_table(LONG_S, queue_length=2)
    first, accepted = table.submit(new("key", owner="anna"))
    assert accepted
    with pytest.raises(KeyReusedError):
        table.submit(new("key", fingerprint="other", owner="anna"))
    theirs, accepted = table.submit(new("key", owner="bert"))
    assert accepted
    assert table.get(theirs.id) == theirs != first
    assert table.submit(new("key", owner="anna")) == (first, False)  # though the queue is full


def test_owners(table: JobTable) -> None:
    of_anna, of_bert, of_nobody = submitted(table, owner="anna"), submitted(table, owner="bert"), submitted(table)
    assert [job.id for job in table.page(10, owner="anna")] == [of_anna]
    assert [(job.id, job.owner) for job in table.page(10)] == [(of_nobody, None), (of_bert, "bert"), (of_anna, "anna")]
    assert table.get(of_anna, "bert") is None
    mine = job_of(table, of_anna, "anna")
    assert mine.owner == "anna"
    assert table.get(of_nobody, "anna") is None


def test_pages(table: JobTable) -> None:
    ids = [submitted(table) for _ in range(5)]
    newest = table.page(2)
    assert [job.id for job in newest] == [ids[4], ids[3]]
    assert [job.id for job in table.page(10, newest[-1].number)] == ids[2::-1]


def test_live_keys(table: JobTable) -> None:
    waiting, failed = submitted(table), submitted(table)
    claim = claimed(table)
    unpublished = bitstream_key(claim.job_id, 1)
    assert table.needed_keys() == {source_key(waiting), source_key(failed), unpublished}
    assert table.release(claim)
    table.remove(waiting)
    assert table.fail(claimed(table), REFUSED)
    assert table.needed_keys() == set()


def test_finished_jobs(table: JobTable) -> None:
    ids = [submitted(table) for _ in range(4)]
    assert table.finish(claimed(table), RESULT)
    assert table.fail(claimed(table), REFUSED)
    claimed(table)
    assert table.finished(-1.0) == ids[:2]
    assert table.finished(60.0) == []


def _submit_and_close(database_url: str, folder: Path, ids: multiprocessing.SimpleQueue[str]) -> None:
    table = open_table(database_url, folder, LONG_S)
    ids.put(table.submit(new("the same key"))[0].id)
    table.close()


def test_processes_open_a_table_that_none_has_made_yet(database_url: str, tmp_path: Path) -> None:
    """And all submit under one key: it is one job."""
    ids = what_all_say(_submit_and_close, 4, database_url, tmp_path)
    assert (len(ids), len(set(ids))) == (4, 1)


@pytest.mark.parametrize("kept_s", [0.0, LONG_S])
def test_bytes_are_counted_as_long_as_they_are_kept(open_job_table: OpenTable, kept_s: float) -> None:
    """Of images of finished jobs too, where those are kept."""
    table = open_job_table(LONG_S, source_retention_s=kept_s)
    done, failed, crashing = (table.submit(new(owner="ann"))[0] for _ in range(3))
    size = done.image.size_bytes
    kept = size if kept_s else 0
    assert table.census().stored_bytes == 3 * size
    claims = {claim.job_id: claim for claim in (claimed(table) for _ in range(3))}
    for _ in range(2):  # as after a commit whose answer was lost
        assert table.finish(claims[done.id], EncodeResult("bitstreams/x", "0" * 64, {"bytes": 7}))
    table.fail(claims[failed.id], REFUSED)
    assert table.census().stored_bytes == size + 7 + 2 * kept
    table.fail(claims[crashing.id], CRASH)
    assert table.census().stored_bytes == size + 7 + 2 * kept  # it is tried again
    while (claim := table.claim("w")) is not None:
        table.fail(claim, CRASH)
    assert table.census().stored_bytes == 7 + 3 * kept
    images = {source_key(job.id) for job in (done, failed, crashing)} if kept else set()
    assert table.needed_keys() == {*images, "bitstreams/x"}
    for job in (done, done, failed, crashing):
        table.source_removed(job.id)
    assert (table.census().stored_bytes, table.needed_keys()) == (7, {"bitstreams/x"})
    table.source_removed(table.submit(new())[0].id)  # which waits
    assert table.census().stored_bytes == 7 + size
    table.remove(done.id)
    assert table.census().stored_bytes == size


def test_quotas(open_job_table: OpenTable) -> None:
    size = new().image.size_bytes

    def refused(owner: str, **quotas: int) -> str:
        with pytest.raises(LimitError, match="remove jobs first") as refusal:
            open_job_table(LONG_S, **quotas).submit(new(owner=owner))
        return refusal.value.reason

    own = open_job_table(LONG_S, own_quota_bytes=size)
    submitted(own, owner="ann")
    assert refused("ann", own_quota_bytes=2 * size - 1) == "own_quota"
    submitted(own, owner="bob")
    assert refused("cat", quota_bytes=3 * size - 1, own_quota_bytes=size) == "quota"
    submitted(open_job_table(LONG_S, quota_bytes=3 * size, own_quota_bytes=size), owner="cat")


def test_what_became_of_jobs_is_counted(table: JobTable) -> None:
    """Whether or not the jobs are still there."""
    done, crashed, refused, cancelled = (submitted(table) for _ in range(4))
    assert table.finish(claimed(table), RESULT)
    assert table.finish(Claim(done, 1, REQUEST, IMAGE), RESULT)  # once more, as after an answer that was lost
    for _ in range(3):  # of RULES
        assert table.fail(claimed(table), CRASH)
    assert table.fail(claimed(table), REFUSED)
    for job_id in (done, crashed, refused, cancelled):
        table.remove(job_id)
    totals = table.census().totals
    assert {name: totals.get(name, 0) for name in ENDINGS} == {"finished": 1, "retried": 2, "failed": 2, "cancelled": 1}
    assert sum(totals.get(bucket(most), 0) for most in BUCKETS_S) == 1
    assert totals[SECONDS] >= 0
