"""Which worker runs which job when, and whose report counts."""

from __future__ import annotations

import json
import multiprocessing
from dataclasses import asdict
from pathlib import Path

import pytest

from service.jobs import table as table_module
from service.jobs.job import Claim, EncodeResult, JobError
from service.jobs.table import JobTable
from service.opening import open_job_table as open_backend_of
from service.settings import Settings
from tests.harness.job_table import (
    CRASH,
    IMAGE,
    LONG_S,
    NO_TIME_S,
    REFUSED,
    REQUEST,
    RESULT,
    OpenTable,
    claimed,
    job_of,
    open_table,
    state,
    submitted,
    what_all_say,
)


def test_jobs_are_claimed_in_order_and_once(table: JobTable) -> None:
    ids = [submitted(table) for _ in range(3)]
    claims = [claimed(table) for _ in range(3)]
    assert [claim.job_id for claim in claims] == ids
    assert claims[0] == Claim(ids[0], 1, REQUEST, IMAGE)
    assert table.claim("w") is None


def test_interactive_jobs_come_before_bulk_jobs(table: JobTable) -> None:
    bulk, late_bulk = submitted(table, priority="bulk"), submitted(table, priority="bulk")
    urgent = submitted(table)
    positions = {job.id: (job.position, job.priority) for job in table.page(10)}
    assert positions == {urgent: (1, "interactive"), bulk: (2, "bulk"), late_bulk: (3, "bulk")}
    assert [claimed(table).job_id for _ in range(3)] == [urgent, bulk, late_bulk]


def test_owners_take_turns(table: JobTable) -> None:
    """The owner with the fewest running jobs is next, then the one served longest ago, then the oldest job."""
    of_anna = [submitted(table, owner="anna") for _ in range(4)]
    of_bert = [submitted(table, owner="bert") for _ in range(2)]
    of_cora = [submitted(table, owner="cora")]
    first = claimed(table)
    assert first.job_id == of_anna[0]
    assert [claimed(table).job_id for _ in range(2)] == [of_bert[0], of_cora[0]]
    assert table.finish(first, RESULT)  # anna has none running
    second = claimed(table)
    assert second.job_id == of_anna[1]
    assert table.finish(second, RESULT)
    third = claimed(table)
    assert third.job_id == of_anna[2]
    # All have one running: bert was served before anna.
    assert [claimed(table).job_id for _ in range(2)] == [of_bert[1], of_anna[3]]


def test_the_operators_limits_reach_the_table(tmp_path: Path) -> None:
    table = open_backend_of(Settings(data_dir=tmp_path, lease_s=LONG_S))
    first = submitted(table)
    for crashes in range(1, 5):
        claim = claimed(table)
        assert claim.job_id == first
        assert table.fail(claim, CRASH)
        assert state(table, first) == ("queued" if crashes < 4 else "failed")
    table.close()


def test_heartbeat_carries_the_trace(table: JobTable) -> None:
    job_id = submitted(table)
    claim = claimed(table)
    assert table.heartbeat(claim, [{"step": 0}, {"step": 1}], 0)
    assert table.heartbeat(claim, [], 2)
    assert table.heartbeat(claim, [{"step": 1}, {"step": 2}], 1)  # a point that was sent twice
    assert table.trace(job_id) == [{"step": 0}, {"step": 1}, {"step": 2}]
    assert table.trace(job_id, 2) == [{"step": 2}]
    assert table.trace(job_id, 3) == []
    assert table.fail(claim, CRASH)
    claimed(table)
    assert table.trace(job_id) == []


def stop_wanted(table: JobTable, claim: Claim) -> bool:
    job = table.heartbeat(claim, [], 0)
    return job is not None and job.stopped


def test_a_stop_is_for_the_attempt_that_runs(table: JobTable) -> None:
    job_id = submitted(table)
    assert not table.stop(job_id)  # it waits
    claim = claimed(table)
    assert not stop_wanted(table, claim)
    assert table.stop(job_id)
    assert stop_wanted(table, claim)
    assert table.fail(claim, CRASH)
    assert not stop_wanted(table, claim)
    again = claimed(table)
    assert not stop_wanted(table, again)
    assert table.finish(again, RESULT)
    assert not table.stop(job_id)
    assert not table.stop("0" * 32)


def test_a_stale_claim_changes_nothing(open_job_table: OpenTable) -> None:
    """Rule 2: once the lease is over and another has claimed the job, the first worker's token is void."""
    hasty = open_job_table(NO_TIME_S)
    job_id = submitted(hasty)
    stale = claimed(hasty)
    assert hasty.reconcile() == []
    fresh = claimed(open_job_table(LONG_S))
    assert (fresh.job_id, fresh.attempt) == (job_id, 2)
    before = hasty.get(job_id)
    assert not hasty.heartbeat(stale, [{"step": 1}], 0)
    assert not hasty.finish(stale, RESULT)
    assert not hasty.fail(stale, CRASH)
    assert not hasty.fail(stale, REFUSED)
    assert not hasty.release(stale)
    assert hasty.get(job_id) == before
    assert hasty.trace(job_id) == []
    assert hasty.finish(fresh, RESULT)
    assert not hasty.finish(stale, EncodeResult("bitstreams/x.9.sg", "cd" * 32, {}))


def test_a_removed_job_is_lost_to_its_worker(table: JobTable) -> None:
    job_id = submitted(table)
    claim = claimed(table)
    assert table.heartbeat(claim, [{"step": 0}], 0)
    removed = table.remove(job_id)
    assert removed is not None
    assert (removed.id, removed.state) == (job_id, "running")
    assert table.remove(job_id) is None
    assert not table.heartbeat(claim, [{"step": 1}], 1)
    assert not table.finish(claim, RESULT)
    assert table.trace(job_id) == []


def test_ends(table: JobTable) -> None:
    """Done, refused, and crashed as often as may be."""
    done, refused, crashing = (submitted(table) for _ in range(3))
    claim = claimed(table)
    for _ in range(2):  # as after a commit whose answer was lost
        assert table.finish(claim, RESULT)
    assert table.fail(claimed(table), REFUSED)
    for attempt in (1, 2):
        claim = claimed(table)
        assert (claim.job_id, claim.attempt) == (crashing, attempt)
        assert table.fail(claim, CRASH)
        assert state(table, crashing) == "queued"
    assert table.fail(claimed(table), JobError("crashed", "the last one"))
    assert table.claim("w") is None
    jobs = [job_of(table, job_id) for job_id in (done, refused, crashing)]
    assert [(job.state, job.crashes, job.result, job.error) for job in jobs] == [
        ("done", 0, RESULT, None),
        ("failed", 0, None, REFUSED),
        ("failed", 3, None, JobError("crashed", "the last one")),
    ]
    assert all(job.finished_at is not None for job in jobs)
    assert table.needed_keys() == {RESULT.bitstream_key}


def test_leases_that_are_over_count_as_crashes(open_job_table: OpenTable) -> None:
    hasty = open_job_table(NO_TIME_S)
    job_id = submitted(hasty)
    for _ in range(2):
        claimed(hasty)
        assert hasty.reconcile() == []
        assert state(hasty, job_id) == "queued"
    claimed(hasty)
    assert [job.id for job in hasty.reconcile()] == [job_id]
    assert state(hasty, job_id) == "failed"


def pass_time(monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
    """Let time pass for the watcher of leases, and none for the leases."""
    now = table_module.time.monotonic()
    monkeypatch.setattr(table_module.time, "monotonic", lambda: now + seconds)


def move_clock(table: JobTable, seconds: float) -> None:
    """Put the table's clock forward after all that was written."""
    with table._transaction() as db:
        db.execute("UPDATE jobs SET lease_until = lease_until - ?", (seconds,))


@pytest.mark.parametrize("lives", [True, False])
@pytest.mark.parametrize("jump_s", [1000.0, 0.0, -1000.0])
def test_a_clock_that_jumps(
    open_job_table: OpenTable, monkeypatch: pytest.MonkeyPatch, jump_s: float, lives: bool
) -> None:
    """It costs nobody a job, nor does an outage, after which every lease is over: a live worker has renewed it by the
    second look. And a worker that is gone is noticed even if its lease lies far in the future by now.
    """
    table = open_job_table(LONG_S)
    submitted(table)
    claim = claimed(table)
    move_clock(table, jump_s)
    assert table.reconcile() == []
    assert state(table, claim.job_id) == "running"
    if lives:
        assert table.heartbeat(claim, [], 0)
    pass_time(monkeypatch, LONG_S if jump_s else 10 * LONG_S)
    assert table.reconcile() == []
    job = job_of(table, claim.job_id)
    expected = ("running", 0) if lives or not jump_s else ("queued", 1)
    assert (job.state, job.crashes) == expected


def test_a_request_of_another_version_holds_up_nobody(table: JobTable) -> None:
    """It is not encoded as if what is new in it were not there, and it fails when nobody has understood it."""
    strange = submitted(table)
    with table._transaction() as db:
        request = json.dumps({**asdict(REQUEST), "mood": 9, "tune": "sharper"})
        db.execute("UPDATE jobs SET request = ? WHERE id = ?", (request, strange))
    plain = submitted(table)
    claims = [table.claim("w") for _ in range(4)]
    assert [claim.job_id for claim in claims if claim is not None] == [plain]
    job = job_of(table, strange)
    assert job.error is not None
    assert (job.state, job.crashes) == ("failed", 3)
    assert asdict(job.request) == {**asdict(REQUEST), "tune": "sharper"}
    assert "another version" in job.error.detail


def test_a_released_job_keeps_its_place_and_counts_no_crash(table: JobTable) -> None:
    first, second = submitted(table), submitted(table)
    assert table.release(claimed(table))
    again = claimed(table)
    assert (again.job_id, again.attempt) == (first, 2)
    job = job_of(table, first)
    assert job.crashes == 0
    assert claimed(table).job_id == second


def _claim_and_finish(database_url: str, folder: Path, ids: multiprocessing.SimpleQueue[str]) -> None:
    table = open_table(database_url, folder, LONG_S)
    while claim := table.claim("w"):
        assert table.heartbeat(claim, [{"step": 1}], 0)
        assert table.finish(claim, RESULT)
        ids.put(claim.job_id)
    table.close()


@pytest.mark.thorough
def test_processes_share_a_table(database_url: str, tmp_path: Path) -> None:
    """No job goes to two of them."""
    first = open_table(database_url, tmp_path, LONG_S)
    expected = {submitted(first) for _ in range(60)}
    first.close()
    seen = what_all_say(_claim_and_finish, 4, database_url, tmp_path)
    assert len(seen) == len(expected)
    assert set(seen) == expected
