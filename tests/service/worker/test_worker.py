"""What a worker does with outcomes, where the real road cannot be made to go wrong at will."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from service.jobs.interface import (
    BackendError,
    Claim,
    EncodeRequest,
    EncodeResult,
    JobRules,
    JsonObject,
    NewJob,
    SourceImage,
    new_job_id,
)
from service.jobs.sqlite import SqliteJobs
from service.process.stopping import StopSignal
from service.settings import Settings
from service.storage.disk import DiskStorage, bitstream_key, source_key
from service.worker import worker as worker_module
from service.worker.encode_process import Encoded, Refused
from service.worker.worker import ClaimLostError, Pulse, StoppedError, Worker

LONG_S = 60.0


class Unsteady(SqliteJobs):
    """A table whose answers get lost: that many calls succeed, and report failure."""

    lost_answers = 0

    def _lose(self) -> None:
        if self.lost_answers:
            self.lost_answers -= 1
            raise BackendError("the answer was lost")

    def finish(self, claim: Claim, result: EncodeResult) -> bool:
        finished = super().finish(claim, result)
        self._lose()
        return finished

    def heartbeat(self, claim: Claim, points: Sequence[JsonObject], first: int) -> bool:
        alive = super().heartbeat(claim, points, first)
        self._lose()
        return alive


class Full(DiskStorage):
    """A disk that takes nothing so many times."""

    refusals = 0

    def put(self, key: str, data: bytes) -> None:
        if self.refusals:
            self.refusals -= 1
            raise OSError(28, "No space left on device")
        super().put(key, data)


@pytest.fixture
def backend(tmp_path: Path) -> Iterator[Unsteady]:
    backend = Unsteady(tmp_path / "jobs.sqlite3", JobRules(LONG_S, 4))
    yield backend
    backend.close()


@pytest.fixture
def storage(tmp_path: Path) -> Full:
    return Full(tmp_path)


@pytest.fixture
def stop() -> StopSignal:
    return StopSignal()


@pytest.fixture
def worker(backend: Unsteady, storage: Full, stop: StopSignal, monkeypatch: pytest.MonkeyPatch) -> Worker:
    monkeypatch.setattr(worker_module, "PAUSE_AFTER_TROUBLE_S", 0.0)
    return Worker(Settings(), backend, storage, stop)


@pytest.fixture
def claim(backend: Unsteady, storage: DiskStorage) -> Claim:
    request, image = EncodeRequest("bpp", 1.0, "paper", 60.0), SourceImage("PNG", 8, 8, 10)
    job, _ = backend.submit(NewJob(new_job_id(), request, image, "f"), 10)
    storage.put(source_key(job.id), b"image")
    claim = backend.claim("w")
    assert claim is not None
    return claim


def result_of(backend: Unsteady, claim: Claim) -> str | None:
    job = backend.get(claim.job_id)
    return job.result.bitstream_key if job and job.result else None


def bitstreams(tmp_path: Path) -> list[str]:
    return sorted(f"bitstreams/{path.name}" for path in (tmp_path / "bitstreams").iterdir())


def test_two_attempts_and_one_result(backend: Unsteady, worker: Worker, claim: Claim, tmp_path: Path) -> None:
    """Rule 3: the attempt that lost its claim publishes nothing and leaves nothing."""
    assert backend.release(claim)
    second = backend.claim("other")
    assert second is not None
    pulse = Pulse(backend, claim)
    with pytest.raises(ClaimLostError):
        worker._conclude(claim, Encoded({}, b"of the first"), pulse)
    assert bitstreams(tmp_path) == []
    worker._conclude(second, Encoded({}, b"of the second"), Pulse(backend, second))
    with pytest.raises(ClaimLostError):
        worker._conclude(claim, Encoded({}, b"of the first, later"), pulse)
    key = bitstream_key(claim.job_id, 2)
    assert bitstreams(tmp_path) == [key]
    assert result_of(backend, claim) == key
    assert (tmp_path / key).read_bytes() == b"of the second"


def test_a_lost_answer_loses_no_result(backend: Unsteady, worker: Worker, claim: Claim, tmp_path: Path) -> None:
    """Rule 7: publishing is tried again, and an update that had happened all the same counts."""
    backend.lost_answers = 2
    worker._conclude(claim, Encoded({"bytes": 4}, b"data"), Pulse(backend, claim))
    assert result_of(backend, claim) == bitstream_key(claim.job_id, 1)
    assert bitstreams(tmp_path) == [bitstream_key(claim.job_id, 1)]


def test_stopping_while_the_table_is_out_of_reach(
    backend: Unsteady, worker: Worker, stop: StopSignal, claim: Claim, tmp_path: Path
) -> None:
    """The bitstream stays for the sweep, since it may have been published."""
    backend.lost_answers = 100
    stop.request()
    with pytest.raises(BackendError):
        worker._conclude(claim, Encoded({}, b"data"), Pulse(backend, claim))
    assert bitstreams(tmp_path) == [bitstream_key(claim.job_id, 1)]


def test_a_result_waits_for_space(backend: Unsteady, worker: Worker, storage: Full, claim: Claim) -> None:
    storage.refusals = 3
    worker._conclude(claim, Encoded({}, b"data"), Pulse(backend, claim))
    assert result_of(backend, claim) == bitstream_key(claim.job_id, 1)


def test_stopping_while_the_disk_is_full(
    backend: Unsteady, worker: Worker, storage: Full, stop: StopSignal, claim: Claim
) -> None:
    storage.refusals = 100
    stop.request()
    with pytest.raises(StoppedError):
        worker._conclude(claim, Encoded({}, b"data"), Pulse(backend, claim))


def test_a_storage_out_of_reach_does_not_count_against_the_job(
    backend: Unsteady, storage: Full, worker: Worker, claim: Claim, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert backend.release(claim)

    def out_of_reach(_key: str) -> None:
        raise OSError(5, "the object store failed")

    monkeypatch.setattr(storage, "open", out_of_reach)
    with pytest.raises(OSError, match="the object store failed"):
        worker.run_one()
    job = backend.get(claim.job_id)
    assert job is not None
    assert (job.state, job.crashes) == ("queued", 0)


def test_a_pulse_sends_each_point_once(backend: Unsteady, claim: Claim) -> None:
    pulse = Pulse(backend, claim)
    pulse.add({"step": 0})
    pulse.beat()  # too early
    assert backend.trace(claim.job_id) == []
    pulse.beat(now=True)
    backend.lost_answers = 1
    pulse.add({"step": 1})
    pulse.beat(now=True)  # written, but reported as failed, so it is sent again
    pulse.add({"step": 2})
    pulse.beat(now=True)
    assert backend.trace(claim.job_id) == [{"step": 0}, {"step": 1}, {"step": 2}]


def test_a_pulse_that_nobody_hears_goes_on(backend: Unsteady, claim: Claim, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rule 2: that a job is lost is the table's word, which silence is not."""
    clock = [1000.0]
    monkeypatch.setattr(worker_module.time, "monotonic", lambda: clock[0])
    backend.lost_answers = 100
    pulse = Pulse(backend, claim)
    pulse.add({"step": 0})
    for _ in range(50):
        clock[0] += 10 * LONG_S
        pulse.beat()
    backend.lost_answers = 0
    pulse.beat(now=True)
    assert backend.trace(claim.job_id) == [{"step": 0}]


@pytest.mark.parametrize("outcome", [Refused("no"), Encoded({}, b"data")])
def test_an_end_is_written_down_however_long_it_takes(
    backend: Unsteady, worker: Worker, claim: Claim, monkeypatch: pytest.MonkeyPatch, outcome: Encoded | Refused
) -> None:
    """Rule 7: else the lease would run out, and that counts as a crash."""
    refusals = iter([BackendError("out of reach")] * 5)
    connection = backend._connection

    def out_of_reach() -> AbstractContextManager[sqlite3.Connection]:
        for error in refusals:
            raise error
        return connection()

    monkeypatch.setattr(backend, "_connection", out_of_reach)
    worker._conclude(claim, outcome, Pulse(backend, claim))
    job = backend.get(claim.job_id)
    assert job is not None
    assert (job.state, job.crashes) == ("done" if isinstance(outcome, Encoded) else "failed", 0)


def test_a_pulse_notices_a_removed_job(backend: Unsteady, claim: Claim) -> None:
    backend.remove(claim.job_id)
    with pytest.raises(ClaimLostError):
        Pulse(backend, claim).beat(now=True)


def test_a_source_that_is_gone(backend: Unsteady, storage: DiskStorage, worker: Worker, claim: Claim) -> None:
    assert backend.release(claim)
    storage.delete(source_key(claim.job_id))
    for _ in range(4):
        assert worker.run_one()
    job = backend.get(claim.job_id)
    assert job is not None
    assert job.error is not None
    assert (job.state, job.error.detail) == ("failed", "the source image is gone")
    assert not worker.run_one()
