"""What docs/deploy.md says of backups and of the move to PostgreSQL and S3, by its own commands."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from tests.service.s3_server import S3Server
from tests.support.data import ROOT, code_in
from tests.support.postgres_server import PostgresServer
from tests.support.service import Service

pytestmark = [
    pytest.mark.thorough,
    pytest.mark.skipif(shutil.which("sqlite3") is None, reason="sqlite3 is not installed: sudo apt install sqlite3"),
]


def run(commands: str, folder: Path, environment: Mapping[str, str]) -> None:
    """Run a block where the data folder lies, with this installation's programs."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{environment['PATH']}"
    known = {**environment, "PATH": path, "PYTHONPATH": str(ROOT)}
    subprocess.run(["bash", "-euo", "pipefail", "-c", commands], cwd=folder, env=known, check=True)


@pytest.fixture
def moving(tmp_path: Path) -> Iterator[Service]:
    """A service with its data where the document has it."""
    service = Service(tmp_path / "data", source_retention_s=3600)
    yield service
    if service.process.poll() is None:
        service.stop()


def bitstream_of(service: Service, job_id: str) -> bytes:
    answer = service.client.get(f"/bitstreams/{job_id}.sg")
    assert answer.status_code == 200
    return answer.content


def test_backup_move_and_backup_again(tmp_path: Path, moving: Service, postgres: PostgresServer, s3: S3Server) -> None:
    """A job is still there after each, its file has the same bytes, and new jobs are encoded."""
    back_up, restore, back_up_stores, restore_stores, *_ = code_in("docs/deploy.md", "sh", "Backup, restore, upgrade")
    places, move = code_in("docs/deploy.md", "sh", "The move from one machine")
    service = moving
    kept = service.accepted()
    job, bitstream = service.wait(kept), bitstream_of(service, kept)
    times = {name: value for name, value in job.items() if name.endswith("_at")}

    def assert_kept() -> None:
        assert {**service.job(kept), **times} == job  # a text of a time may have lost its last microseconds
        assert bitstream_of(service, kept) == bitstream
        assert service.client.get(f"/jobs/{kept}/comparison.webp").is_success  # which is made from the job's image
        assert service.wait(service.accepted())["state"] == "done"

    def assert_restored(back_up: str, restore: str) -> None:
        run(back_up, tmp_path, service.environment)
        assert service.client.delete(f"/jobs/{kept}").status_code == 204
        service.stop()
        run(restore, tmp_path, service.environment)
        service.start()
        assert_kept()

    assert_restored(back_up, restore)
    waiting = service.accepted_slow()
    service.stop()

    names = dict(re.findall(r"(RCLONE_\w+)=(\S+)", places))
    stores = {"SG_DATABASE_URL": postgres.new_database(), "SG_STORAGE_URL": s3.new_storage(), **s3.environment}
    service.environment |= {**stores, **names}
    run(move, tmp_path, service.environment)
    shutil.move(tmp_path / "data", tmp_path / "moved")
    service.start()
    service.wait(waiting, "running")
    assert service.client.delete(f"/jobs/{waiting}").status_code == 204
    assert_kept()

    shutil.move(tmp_path / "backup", tmp_path / "older")
    assert_restored(back_up_stores, restore_stores)
