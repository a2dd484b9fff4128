"""What is no longer needed goes, and nothing else does."""

from __future__ import annotations

import os
import socket
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from service.errors import JobTableError
from service.jobs.job import EncodeResult, new_job_id
from service.jobs.table import JobTable
from service.processes import StopSignal
from service.sandbox.client import Sandbox
from service.settings import Settings
from service.storage.files import DiskStorage, Storage, bitstream_key, source_key
from service.worker.loop import Worker
from service.worker.sweeping import SweepResult, pause_s, sweep
from tests.support import job_table
from tests.support.job_table import IMAGE, LONG_S, REFUSED, OpenTable, change, claimed
from tests.support.processes import failing, wait_until

AT_ONCE_S = -5.0
HOUR_S = 3600


@pytest.fixture
def open_job_table(open_job_table: OpenTable) -> OpenTable:
    """Opens a table that is an hour old."""

    def opener(lease_s: float, **options: Any) -> JobTable:
        table = open_job_table(lease_s, **options)
        change(table, f"UPDATE totals SET amount = amount - {HOUR_S} WHERE name = 'made_at'")
        return table

    return opener


@pytest.fixture
def storage(tmp_path: Path) -> Storage:
    return DiskStorage(tmp_path)


def submitted(table: JobTable, storage: Storage) -> str:
    job_id = job_table.submitted(table)
    storage.put(source_key(job_id), b"image")
    return job_id


def finished(table: JobTable, storage: Storage) -> str:
    submitted(table, storage)
    claim = claimed(table)
    key = bitstream_key(claim.id, claim.attempt)
    storage.put(key, b"bitstream")
    assert table.finish(claim, EncodeResult("", {}))
    storage.delete(source_key(claim.id))
    return claim.id


def stored(storage: Storage) -> set[str]:
    return set(storage.old(AT_ONCE_S))


def test_files_that_no_job_needs_go(table: JobTable, storage: Storage) -> None:
    done = finished(table, storage)
    running, waiting = submitted(table, storage), submitted(table, storage)
    assert claimed(table).id == running
    storage.put(bitstream_key(running, 1), b"not published yet")
    needed = stored(storage)
    kept = {bitstream_key(done, 1), bitstream_key(running, 1)}
    assert needed == {*kept, source_key(running), source_key(waiting)}
    orphans = {source_key(new_job_id()), source_key(done), bitstream_key(done, 2), "unfinished/" + new_job_id()}
    for key in orphans:
        storage.put(key, b"left over")
    assert sweep(table, storage, retention_s=0) == SweepResult(0, 0)  # they may be of a job that is just being accepted
    assert sweep(table, storage, retention_s=0, orphan_age_s=AT_ONCE_S) == SweepResult(0, 4)
    assert stored(storage) == needed


def test_files_of_another_job_table_stay(table: JobTable, storage: Storage, tmp_path: Path) -> None:
    """As with the wrong database, or a table that was lost."""
    theirs = bitstream_key(new_job_id(), 1)
    storage.put(theirs, b"bitstream")
    just_before = time.time() - HOUR_S - 1
    os.utime(tmp_path / theirs, (just_before, just_before))
    table.remove(finished(table, storage))
    assert sweep(table, storage, retention_s=0, orphan_age_s=AT_ONCE_S) == SweepResult(0, 1)
    assert stored(storage) == {theirs}


def test_a_file_that_cannot_be_removed_holds_up_no_other(
    open_job_table: OpenTable, storage: Storage, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Such as an object under legal hold. Its image goes on counting, and it goes once it may."""
    table = open_job_table(LONG_S, source_retention_s=60.0)
    orphans = [source_key(new_job_id()) for _ in range(3)]
    for key in orphans:
        storage.put(key, b"left over")
    jobs = [submitted(table, storage) for _ in range(4)]
    for _ in jobs:
        claim = claimed(table)
        storage.put(bitstream_key(claim.id, 1), b"bitstream")
        assert table.finish(claim, EncodeResult("", {"bytes": 9}))
    held = {orphans[0], source_key(jobs[0]), bitstream_key(jobs[1], 1)}
    remove = storage.delete

    def delete(key: str) -> None:
        if key in held:
            raise PermissionError(f"AccessDenied: {key}")
        remove(key)

    monkeypatch.setattr(storage, "delete", delete)
    times = {"source_retention_s": AT_ONCE_S, "orphan_age_s": AT_ONCE_S}
    assert sweep(table, storage, retention_s=1000, **times) == SweepResult(0, 5, 2)
    assert table.counts().stored_bytes == IMAGE.bytes + 4 * 9
    assert sweep(table, storage, retention_s=AT_ONCE_S, **times) == SweepResult(4, 0, 3)
    assert table.page(10) == []
    assert stored(storage) == held
    assert all(f"{key} cannot be removed: AccessDenied" in caplog.text for key in held)
    held.clear()
    assert sweep(table, storage, retention_s=AT_ONCE_S, **times) == SweepResult(0, 3)
    assert stored(storage) == set()


def test_files_are_removed_even_if_the_job_table_cannot_be_written(
    open_job_table: OpenTable, storage: Storage, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = open_job_table(LONG_S, source_retention_s=60.0)
    ended, orphan = submitted(table, storage), source_key(new_job_id())
    assert table.fail(claimed(table), REFUSED)
    storage.put(orphan, b"left over")
    assert stored(storage) == {source_key(ended), orphan}
    monkeypatch.setattr(table, "_transaction", failing(table._transaction, JobTableError("disk is full")))
    with pytest.raises(JobTableError):
        sweep(table, storage, retention_s=AT_ONCE_S, source_retention_s=AT_ONCE_S, orphan_age_s=AT_ONCE_S)
    assert stored(storage) == set()
    assert sweep(table, storage, retention_s=AT_ONCE_S, source_retention_s=AT_ONCE_S) == SweepResult(1, 1)
    assert table.page(10) == []


def test_an_image_goes_when_its_time_is_over(open_job_table: OpenTable, storage: Storage) -> None:
    """However young it is; and once. Then it is not counted any more."""
    table = open_job_table(LONG_S, source_retention_s=60.0)
    done, refused, waiting = (submitted(table, storage) for _ in range(3))
    assert table.finish(claimed(table), EncodeResult("", {"bytes": 7}))
    assert table.fail(claimed(table), REFUSED)
    assert sweep(table, storage, retention_s=1000, source_retention_s=60) == SweepResult(0, 0)
    for swept in (SweepResult(0, 2), SweepResult(0, 0)):
        assert sweep(table, storage, retention_s=1000, source_retention_s=AT_ONCE_S) == swept
        assert stored(storage) == {source_key(waiting)}
    assert table.counts().stored_bytes == 7 + IMAGE.bytes
    assert {job.id for job in table.page(10)} == {done, refused, waiting}


def test_the_sweeper_needs_no_job_to_begin(table: JobTable, storage: Storage) -> None:
    """On PostgreSQL a worker without jobs never swept."""
    finished(table, storage)
    until, (requests, silent) = StopSignal(), socket.socketpair()
    with requests, silent:
        settings = Settings(retention_s=0.5, source_retention_s=0)
        worker = threading.Thread(target=Worker(settings, table, storage, Sandbox(requests), until).run)
        worker.start()
        wait_until(lambda: table.page(10) == [] and stored(storage) == set())
        until.request()
        worker.join()


@pytest.mark.parametrize(
    ("kept_s", "pause"), [((0, 0), 3600), ((2_592_000, 3600), 900), ((600, 0), 150), ((0.1, 60), 1), ((1e9, 1e9), 3600)]
)
def test_how_often_is_swept(kept_s: tuple[float, float], pause: float) -> None:
    assert pause_s(*kept_s) == pause


def test_a_job_with_many_attempts_goes_with_few_deletes(
    table: JobTable, storage: Storage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While its storage was away for hours, it was claimed each second. The next sweep finds what is older."""
    old = bitstream_key(finished(table, storage), 1)
    change(table, "UPDATE jobs SET attempt = 5000")
    storage.put(bitstream_key(table.page(1)[0].id, 5000), b"left over")
    deleted: list[str] = []
    remove = storage.delete

    def delete(key: str) -> None:
        deleted.append(key)
        remove(key)

    monkeypatch.setattr(storage, "delete", delete)
    assert sweep(table, storage, retention_s=AT_ONCE_S).jobs == 1
    assert len(deleted) < 50
    assert stored(storage) == {old}
    assert sweep(table, storage, retention_s=0, orphan_age_s=AT_ONCE_S) == SweepResult(0, 1)


def test_finished_jobs_go_when_their_time_is_over(table: JobTable, storage: Storage) -> None:
    """With what a killed worker left behind."""
    finished(table, storage)
    submitted(table, storage)
    killed = claimed(table)
    storage.put(bitstream_key(killed.id, 1), b"left over")
    assert table.release(killed)
    refused = claimed(table)
    assert table.fail(refused, REFUSED)
    storage.delete(source_key(refused.id))
    waiting = submitted(table, storage)
    assert sweep(table, storage, retention_s=60) == SweepResult(0, 0)
    assert sweep(table, storage, retention_s=0) == SweepResult(0, 0)  # never
    assert len(table.page(10)) == 3
    assert sweep(table, storage, retention_s=AT_ONCE_S) == SweepResult(2, 0)
    assert [job.id for job in table.page(10)] == [waiting]
    assert stored(storage) == {source_key(waiting)}
