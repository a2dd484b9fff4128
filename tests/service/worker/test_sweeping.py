"""What is no longer needed goes, and nothing else does."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from service.jobs.interface import EncodeResult, JobBackend, JobError, JobRules, new_job_id
from service.jobs.sqlite import SqliteJobs
from service.storage.disk import DiskStorage, Storage, bitstream_key, source_key
from service.worker.sweeping import Swept, sweep
from tests.harness import job_table
from tests.harness.job_table import claimed

AT_ONCE_S = -5.0


@pytest.fixture
def backend(tmp_path: Path) -> Iterator[JobBackend]:
    backend = SqliteJobs(tmp_path / "jobs.sqlite3", JobRules(60.0, 4))
    yield backend
    backend.close()


@pytest.fixture
def storage(tmp_path: Path) -> Storage:
    return DiskStorage(tmp_path)


def submitted(backend: JobBackend, storage: Storage) -> str:
    job_id = job_table.submitted(backend)
    storage.put(source_key(job_id), b"image")
    return job_id


def finished(backend: JobBackend, storage: Storage) -> str:
    submitted(backend, storage)
    claim = claimed(backend)
    key = bitstream_key(claim.job_id, claim.attempt)
    storage.put(key, b"bitstream")
    assert backend.finish(claim, EncodeResult(key, "", {}))
    storage.delete(source_key(claim.job_id))
    return claim.job_id


def stored(storage: Storage) -> set[str]:
    return set(storage.old(AT_ONCE_S))


def test_files_that_no_job_needs_go(backend: JobBackend, storage: Storage) -> None:
    done = finished(backend, storage)
    running, waiting = submitted(backend, storage), submitted(backend, storage)
    assert claimed(backend).job_id == running
    storage.put(bitstream_key(running, 1), b"not published yet")
    needed = stored(storage)
    assert needed == {
        bitstream_key(done, 1),
        *(source_key(running), source_key(waiting)),
        bitstream_key(running, 1),
    }
    orphans = {source_key(new_job_id()), source_key(done), bitstream_key(done, 2), "unfinished/" + new_job_id()}
    for key in orphans:
        storage.put(key, b"left over")
    assert sweep(backend, storage, retention_s=0) == Swept(0, 0)  # they may be of a job that is just being accepted
    assert sweep(backend, storage, retention_s=0, orphan_age_s=AT_ONCE_S, dry_run=True) == Swept(0, 4)
    assert stored(storage) == needed | orphans
    assert sweep(backend, storage, retention_s=0, orphan_age_s=AT_ONCE_S) == Swept(0, 4)
    assert stored(storage) == needed


def test_finished_jobs_go_when_their_time_is_over(backend: JobBackend, storage: Storage) -> None:
    finished(backend, storage)
    submitted(backend, storage)
    refused = claimed(backend)
    assert backend.fail(refused, JobError("refused", "no"), retry=False)
    storage.delete(source_key(refused.job_id))
    waiting = submitted(backend, storage)
    assert sweep(backend, storage, retention_s=60) == Swept(0, 0)
    assert sweep(backend, storage, retention_s=0) == Swept(0, 0)  # never
    assert sweep(backend, storage, retention_s=AT_ONCE_S, dry_run=True) == Swept(2, 0)
    assert len(backend.page(10)) == 3
    assert sweep(backend, storage, retention_s=AT_ONCE_S) == Swept(2, 0)
    assert [job.id for job in backend.page(10)] == [waiting]
    assert stored(storage) == {source_key(waiting)}
