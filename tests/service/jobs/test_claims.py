"""Who runs which job when, and whose word counts."""

from __future__ import annotations

import json
import multiprocessing
from dataclasses import asdict
from pathlib import Path

import pytest

from service.backends import open_backend as open_backend_of
from service.jobs import sql
from service.jobs.interface import (
    Claim,
    EncodeResult,
    JobBackend,
    JobError,
)
from service.jobs.sql import SqlJobs
from service.settings import Settings
from tests.harness.job_table import (
    CRASH,
    LONG_S,
    NO_TIME_S,
    REQUEST,
    RESULT,
    OpenTable,
    claimed,
    open_table,
    state,
    submitted,
    what_all_say,
)


def test_jobs_are_claimed_in_order_and_once(backend: JobBackend) -> None:
    ids = [submitted(backend) for _ in range(3)]
    claims = [claimed(backend) for _ in range(3)]
    assert [claim.job_id for claim in claims] == ids
    assert claims[0] == Claim(ids[0], 1, REQUEST)
    assert backend.claim("w") is None


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


def test_running_jobs_of_an_owner_are_limited(open_backend: OpenTable) -> None:
    backend = open_backend(LONG_S, max_running_per_owner=1)
    first, second = [submitted(backend, owner="anna") for _ in range(2)]
    other = submitted(backend, owner="bert", priority="bulk")
    claim = claimed(backend)
    assert (claim.job_id, claimed(backend).job_id) == (first, other)
    assert backend.claim("w") is None
    assert state(backend, second) == "queued"
    assert backend.finish(claim, RESULT)
    assert claimed(backend).job_id == second


def test_the_operators_limits_reach_the_table(tmp_path: Path) -> None:
    backend = open_backend_of(Settings(data_dir=tmp_path, max_running_per_key=1, max_attempts=2, lease_s=LONG_S))
    first, second = [submitted(backend, owner="anna") for _ in range(2)]
    for crashes in (1, 2):
        claim = claimed(backend)
        assert (claim.job_id, backend.claim("w")) == (first, None)
        assert backend.fail(claim, CRASH, retry=True)
        assert state(backend, first) == ("queued" if crashes == 1 else "failed")
    assert claimed(backend).job_id == second
    backend.close()


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


def test_a_stale_claim_changes_nothing(open_backend: OpenTable) -> None:
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


def test_leases_that_are_over_count_as_crashes(open_backend: OpenTable) -> None:
    hasty = open_backend(NO_TIME_S)
    job_id = submitted(hasty)
    for _ in range(2):
        claimed(hasty)
        assert hasty.reconcile() == []
        assert state(hasty, job_id) == "queued"
    claimed(hasty)
    assert [job.id for job in hasty.reconcile()] == [job_id]
    assert state(hasty, job_id) == "failed"


def test_a_live_lease_is_left_alone(open_backend: OpenTable, monkeypatch: pytest.MonkeyPatch) -> None:
    backend = open_backend(LONG_S)
    job_id = submitted(backend)
    claimed(backend)
    assert backend.reconcile() == []
    pass_time(monkeypatch, 10 * LONG_S)
    assert backend.reconcile() == []
    assert state(backend, job_id) == "running"


def pass_time(monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
    """Let so much time pass for who watches leases, and none for the leases."""
    now = sql.time.monotonic()
    monkeypatch.setattr(sql.time, "monotonic", lambda: now + seconds)


def move_clock(backend: JobBackend, seconds: float) -> None:
    """Put the table's clock forward after all that was written."""
    assert isinstance(backend, SqlJobs)
    with backend._transaction() as db:
        db.execute("UPDATE jobs SET lease_until = lease_until - ?", (seconds,))


@pytest.mark.parametrize("jump_s", [1000.0, -1000.0])
def test_a_clock_that_jumps_costs_nobody_a_job(
    open_backend: OpenTable, monkeypatch: pytest.MonkeyPatch, jump_s: float
) -> None:
    """Nor does an outage, after which every lease is over: who lives has renewed it by the second look."""
    backend = open_backend(LONG_S)
    submitted(backend)
    claim = claimed(backend)
    move_clock(backend, jump_s)
    assert backend.reconcile() == []
    assert backend.heartbeat(claim, [], 0)
    pass_time(monkeypatch, LONG_S)
    assert backend.reconcile() == []
    job = backend.get(claim.job_id)
    assert job is not None
    assert (job.state, job.crashes) == ("running", 0)


@pytest.mark.parametrize("jump_s", [1000.0, -1000.0])
def test_a_clock_that_jumps_keeps_no_job(
    open_backend: OpenTable, monkeypatch: pytest.MonkeyPatch, jump_s: float
) -> None:
    """A worker that is gone is noticed even if its lease lies far in the future by now."""
    backend = open_backend(LONG_S)
    job_id = submitted(backend)
    claimed(backend)
    move_clock(backend, jump_s)
    assert backend.reconcile() == []
    assert state(backend, job_id) == "running"
    pass_time(monkeypatch, LONG_S)
    assert backend.reconcile() == []
    assert state(backend, job_id) == "queued"


def test_a_request_of_another_version_holds_up_nobody(backend: JobBackend) -> None:
    """It is not encoded as if what is new in it were not there, and it fails when nobody has understood it."""
    assert isinstance(backend, SqlJobs)
    strange = submitted(backend)
    with backend._transaction() as db:
        request = json.dumps({**asdict(REQUEST), "effort": 9})
        db.execute("UPDATE jobs SET request = ? WHERE id = ?", (request, strange))
    plain = submitted(backend)
    claims = [backend.claim("w") for _ in range(4)]
    assert [claim.job_id for claim in claims if claim is not None] == [plain]
    job = backend.get(strange)
    assert job is not None
    assert job.error is not None
    assert (job.state, job.crashes, job.request) == ("failed", 3, REQUEST)
    assert "another version" in job.error.detail


def test_a_released_job_keeps_its_place_and_counts_no_crash(backend: JobBackend) -> None:
    first, second = submitted(backend), submitted(backend)
    assert backend.release(claimed(backend))
    again = claimed(backend)
    assert (again.job_id, again.attempt) == (first, 2)
    job = backend.get(first)
    assert job is not None
    assert job.crashes == 0
    assert claimed(backend).job_id == second


def _claim_and_finish(database_url: str, folder: Path, ids: multiprocessing.SimpleQueue[str]) -> None:
    backend = open_table(database_url, folder, LONG_S)
    while claim := backend.claim("w"):
        assert backend.heartbeat(claim, [{"step": 1}], 0)
        assert backend.finish(claim, RESULT)
        ids.put(claim.job_id)
    backend.close()


def test_processes_share_a_table(database_url: str, tmp_path: Path) -> None:
    """No job goes to two of them."""
    first = open_table(database_url, tmp_path, LONG_S)
    expected = {submitted(first) for _ in range(60)}
    first.close()
    seen = what_all_say(_claim_and_finish, 4, database_url, tmp_path)
    assert len(seen) == len(expected)
    assert set(seen) == expected
