"""What a worker does with outcomes, where the real road cannot be made to go wrong at will."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from service.errors import JobTableError
from service.jobs import statements
from service.jobs.job import EncodeResult, Job, JobError, JsonObject
from service.jobs.sqlite import SqliteJobTable
from service.jobs.table import IMAGE_LOST, MAX_LOSSES
from service.processes import StopSignal
from service.sandbox.client import Sandbox, SandboxUnavailableError
from service.sandbox.frames import MAX_TASK_BYTES
from service.settings import Settings
from service.storage.files import DiskStorage, Storage, bitstream_key, source_key
from service.worker import attempt as attempt_module, loop
from service.worker.attempt import Attempt, Encoded, StoppedError
from service.worker.loop import Worker
from tests.support.job_table import IMAGE, LONG_S, change, claimed, job_of, settings, submitted
from tests.support.processes import TIMEOUT_S, failing, wait_until


class Unsteady(SqliteJobTable):
    """A table whose answers get lost: that many calls succeed, and report failure."""

    lost_answers = 0

    def _lose(self) -> None:
        if self.lost_answers:
            self.lost_answers -= 1
            raise JobTableError("the answer was lost")

    def finish(self, claim: Job, result: EncodeResult) -> bool:
        finished = super().finish(claim, result)
        self._lose()
        return finished

    def heartbeat(self, claim: Job, points: Sequence[JsonObject], first: int) -> bool:
        is_ours = super().heartbeat(claim, points, first)
        self._lose()
        return is_ours


@pytest.fixture
def table(tmp_path: Path) -> Iterator[Unsteady]:
    table = Unsteady(tmp_path / "jobs.sqlite3", settings())
    yield table
    table.close()


@pytest.fixture
def storage(tmp_path: Path) -> Storage:
    return DiskStorage(tmp_path)


@pytest.fixture
def stop() -> StopSignal:
    return StopSignal()


@pytest.fixture
def worker(table: Unsteady, storage: Storage, stop: StopSignal) -> Iterator[Worker]:
    requests, silent = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with requests, silent:
        yield Worker(Settings(), table, storage, Sandbox(requests), stop)


@pytest.fixture
def claim(table: Unsteady, storage: Storage) -> Job:
    storage.put(source_key(submitted(table)), bytes(IMAGE.bytes))
    return claimed(table)


@pytest.fixture(autouse=True)
def no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attempt_module, "PAUSE_AFTER_TROUBLE_S", 0.0)


@pytest.fixture
def attempt(table: Unsteady, storage: Storage, stop: StopSignal, claim: Job) -> Attempt:
    return Attempt(table, storage, claim, stop)


def result_of(table: Unsteady, claim: Job) -> str | None:
    job = table.get(claim.id)
    return bitstream_key(job.id, job.attempt) if job and job.state == "done" else None


def bitstreams(tmp_path: Path) -> list[str]:
    return sorted(f"bitstreams/{path.name}" for path in (tmp_path / "bitstreams").iterdir())


def test_a_lost_answer_loses_no_result(table: Unsteady, attempt: Attempt, claim: Job, tmp_path: Path) -> None:
    """Rule 7: publishing is tried again, and an update that had happened all the same counts."""
    table.lost_answers = 2
    attempt.conclude(Encoded({"bytes": 4}, b"data"))
    assert result_of(table, claim) == bitstream_key(claim.id, 1)
    assert bitstreams(tmp_path) == [bitstream_key(claim.id, 1)]


def test_stopping_while_the_table_is_out_of_reach(
    table: Unsteady, attempt: Attempt, stop: StopSignal, claim: Job, tmp_path: Path
) -> None:
    """The bitstream stays for the sweep, since it may have been published."""
    table.lost_answers = 100
    stop.request()
    with pytest.raises(JobTableError):
        attempt.conclude(Encoded({}, b"data"))
    assert bitstreams(tmp_path) == [bitstream_key(claim.id, 1)]


def test_a_result_waits_for_space(
    table: Unsteady, attempt: Attempt, storage: Storage, claim: Job, stop: StopSignal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(storage, "put", failing(storage.put, *[OSError(28, "No space left on device")] * 3))
    attempt.conclude(Encoded({}, b"data"))
    assert result_of(table, claim) == bitstream_key(claim.id, 1)
    monkeypatch.setattr(storage, "put", failing(storage.put, *[OSError(28, "No space left on device")] * 100))
    stop.request()
    with pytest.raises(StoppedError):
        attempt.conclude(Encoded({}, b"data"))


def test_the_lease_is_renewed_while_the_storage_is_slow(
    table: Unsteady, attempt: Attempt, storage: Storage, claim: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bucket may take a minute for one file, and a lease is shorter."""
    monkeypatch.setattr(attempt_module, "HEARTBEAT_S", 0.01)
    put, beats = storage.put, []

    def slow(key: str, data: bytes) -> None:
        wait_until(lambda: len(beats) > 3)
        put(key, data)

    monkeypatch.setattr(storage, "put", slow)
    monkeypatch.setattr(attempt, "beat", lambda: beats.append(1))
    attempt.conclude(Encoded({}, b"data"))
    assert result_of(table, claim) == bitstream_key(claim.id, 1)


def test_a_storage_out_of_reach_does_not_count_against_the_job(
    table: Unsteady, storage: Storage, worker: Worker, claim: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A job was claimed each second meanwhile: after hours, it had thousands of attempts."""
    assert table.release(claim)
    monkeypatch.setattr(loop, "BEGINS_S", 0.0)
    away = OSError(5, "the object store failed")
    monkeypatch.setattr(storage, "open", failing(storage.open, away))
    monkeypatch.setattr(storage, "check", failing(storage.check, away, away))
    for _ in range(3):
        with pytest.raises(OSError, match="the object store failed"):
            worker.run_one()
        job = job_of(table, claim.id)
        assert (job.state, job.crashes, job.attempt) == ("queued", 0, claim.attempt + 1)
    change(table, "UPDATE jobs SET lease_until = epoch()")
    with pytest.raises(SandboxUnavailableError):  # the storage is back, and the next attempt gets further
        worker.run_one()


def test_an_image_that_cannot_be_read_holds_up_no_other(
    table: Unsteady, storage: Storage, worker: Worker, claim: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As one in a bad sector, of a storage that works: its worker claimed it each second, and no other job."""
    assert table.release(claim)
    monkeypatch.setattr(storage, "open", failing(storage.open, OSError(5, "Input/output error")))
    with pytest.raises(OSError, match="Input/output error"):
        worker.run_one()
    assert job_of(table, claim.id).losses == 0
    other = submitted(table)
    assert claimed(table).id == other


def test_a_heartbeat_sends_each_point_once(
    table: Unsteady, storage: Storage, stop: StopSignal, claim: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(attempt_module, "HEARTBEAT_S", LONG_S)
    attempt = Attempt(table, storage, claim, stop)
    attempt.add({"step": 0})
    attempt.beat()  # too early
    assert table.trace(claim.id) == []
    attempt.beat(now=True)
    table.lost_answers = 1
    attempt.add({"step": 1})
    attempt.beat(now=True)  # written, but reported as failed, so it is sent again
    attempt.add({"step": 2})
    attempt.beat(now=True)
    assert table.trace(claim.id) == [{"step": 0}, {"step": 1}, {"step": 2}]


def test_a_trace_has_few_points_whatever_an_encode_sends(
    table: Unsteady, storage: Storage, stop: StopSignal, claim: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A taken-over one could fill the job table, and a long one the page. The last point is always there."""
    clock = [0.0]
    monkeypatch.setattr(attempt_module.time, "monotonic", lambda: clock[0])
    attempt = Attempt(table, storage, claim, stop)
    monkeypatch.setattr(attempt, "_points", points := [])
    for step in range(60_000):
        clock[0] = step / 100
        attempt.add({"step": step})
    assert len([point for point in points if point["step"] <= 100]) == 101
    assert len(points) < 800
    attempt.beat(now=True)
    assert table.trace(claim.id)[-1] == {"step": 59_999}


def test_heartbeats_go_on_without_a_table(
    table: Unsteady, storage: Storage, stop: StopSignal, claim: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rule 2: that a job is lost is the table's word, which silence is not."""
    clock = [1000.0]
    monkeypatch.setattr(attempt_module.time, "monotonic", lambda: clock[0])
    table.lost_answers = 100
    attempt = Attempt(table, storage, claim, stop)
    attempt.add({"step": 0})
    for _ in range(50):
        clock[0] += 10 * LONG_S
        attempt.beat()
    table.lost_answers = 0
    attempt.beat(now=True)
    assert table.trace(claim.id) == [{"step": 0}]


@pytest.mark.parametrize("outcome", [JobError("refused", "no"), Encoded({}, b"data")])
def test_an_end_is_written_down_however_long_it_takes(
    table: Unsteady, attempt: Attempt, claim: Job, monkeypatch: pytest.MonkeyPatch, outcome: Encoded | JobError
) -> None:
    """Rule 7: else the lease would run out, and that counts as a crash."""
    monkeypatch.setattr(table, "_connection", failing(table._connection, *[JobTableError("out of reach")] * 5))
    attempt.conclude(outcome)
    job = job_of(table, claim.id)
    assert (job.state, job.crashes) == ("done" if isinstance(outcome, Encoded) else "failed", 0)


def test_unexpected_errors_do_not_end_a_worker(
    worker: Worker, stop: StopSignal, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail() -> bool:
        stop.request()
        raise ZeroDivisionError

    monkeypatch.setattr(worker, "run_one", fail)
    worker.run()
    assert "running a job failed unexpectedly" in caplog.text


def test_a_worker_whose_jobs_do_not_begin_ends(
    table: Unsteady, worker: Worker, claim: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its sandbox was stopped for 140 s, and everything called it healthy."""
    for name in ("BEGINS_S", "BEGINS_SOON_S"):
        monkeypatch.setattr(loop, name, 0.0)
    table.release(claim)
    with pytest.raises(SandboxUnavailableError):
        worker.run_one()
    worker._register()
    assert table.counts().workers == {}
    monkeypatch.setattr(loop, "GIVES_UP_S", 0.0)
    assert not worker.run()
    assert job_of(table, claim.id).state == "queued"  # for another


@pytest.mark.parametrize("stored", [None, b"", bytes(IMAGE.bytes - 1)])
def test_an_image_that_is_missing_or_cut(
    table: Unsteady, storage: Storage, worker: Worker, claim: Job, monkeypatch: pytest.MonkeyPatch, stored: bytes | None
) -> None:
    """It failed its job for good, or after four attempts in 4 s. Others go on, and it may come back."""
    assert table.release(claim)
    key = source_key(claim.id)
    storage.delete(key) if stored is None else storage.put(key, stored)
    assert worker.run_one()
    job = job_of(table, claim.id)
    assert (job.state, job.crashes, job.losses) == ("queued", 0, 1)
    change(table, "UPDATE jobs SET created_at = 0")
    assert not worker.run_one()  # it is put off
    counts = table.counts()
    assert (counts.totals, counts.waiting_s) == ({"put_off": 1}, None)  # what raises no alert of crashes and waits
    change(table, "UPDATE jobs SET lease_until = epoch() WHERE id = ?", claim.id)
    assert 0 <= (table.counts().waiting_s or 0) < LONG_S
    change(table, "UPDATE jobs SET lease_until = epoch() + 3600 WHERE id = ?", claim.id)
    assert table.counts().waiting_s is not None  # a clock that was set back puts nothing off for longer
    change(table, "UPDATE jobs SET lease_until = epoch() + 50 WHERE id = ?", claim.id)
    other = submitted(table)
    assert claimed(table).id == other
    monkeypatch.setattr(statements, "PUT_OFF_S", 0.0)
    change(table, "UPDATE jobs SET lease_until = 0 WHERE id = ?", claim.id)
    for _ in range(MAX_LOSSES - 1):
        assert worker.run_one()
    job = job_of(table, claim.id)
    assert (job.state, job.error) == ("failed", IMAGE_LOST)
    assert not worker.run_one()


def test_a_storage_that_is_away_has_lost_no_image(table: Unsteady, worker: Worker, claim: Job, tmp_path: Path) -> None:
    """As a folder that is not mounted yet."""
    assert table.release(claim)
    (tmp_path / "sources").rename(tmp_path / "elsewhere")
    with pytest.raises(FileNotFoundError):
        worker.run_one()
    assert (job_of(table, claim.id).state, job_of(table, claim.id).losses) == ("queued", 0)


def test_an_encoder_that_speaks_nonsense(table: Unsteady, storage: Storage, stop: StopSignal, claim: Job) -> None:
    """As a compromised one does. It is that job's failure, and the worker goes on."""
    assert table.release(claim)
    requests, sandbox = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)

    def answer() -> None:
        for _ in range(4):
            _, (number, file), _, _ = socket.recv_fds(sandbox, MAX_TASK_BYTES, 2)
            os.close(file)
            with socket.socket(fileno=number) as other:
                other.sendall(b"nonsense")

    encoder = threading.Thread(target=answer)
    encoder.start()
    with requests, sandbox:
        worker = Worker(Settings(), table, storage, Sandbox(requests), stop)
        assert [worker.run_one() for _ in range(5)] == [True] * 4 + [False]
        encoder.join(TIMEOUT_S)
    job = job_of(table, claim.id)
    assert job.error is not None
    assert (job.state, job.error.code) == ("failed", "crashed")
    assert job.error.detail.startswith("the encoder sent an invalid message: a message of")
