"""Upgrades of the job table from that of 1.0.0rc2, which is kept as a dump of either database."""

from __future__ import annotations

import sqlite3
import subprocess
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import psycopg
import pytest

from service.errors import JobTableError
from service.jobs import migrations
from service.jobs.job import EncodeResult
from service.jobs.outcomes import ENCODING, histogram, total_of
from tests.service.jobs.test_table import submit_once
from tests.support.data import DATA
from tests.support.job_table import (
    LONG_S,
    NO_TIME_S,
    RESULT,
    OpenTable,
    claimed,
    job_of,
    new,
    open_table,
    state,
    what_all_say,
)
from tests.support.postgres_server import PostgresServer, find_binaries
from tests.support.service import RunCommand

DONE, FAILED, RUNNING, WAITING, BULK = (32 * letter for letter in "abcde")
FILE = EncodeResult(f"bitstreams/{DONE}.1.sg", "ab" * 32, {"bytes": 100, "psnr": None})


@pytest.fixture
def old_url(database_url: str, tmp_path: Path) -> str:
    """SG_DATABASE_URL of a table of version 4."""
    restore(database_url, tmp_path)
    return database_url


def restore(url: str, folder: Path) -> None:
    dump = (DATA / "jobs" / f"4.{'sqlite' if url == 'sqlite' else 'postgresql'}.sql").read_text()
    if url == "sqlite":
        with closing(sqlite3.connect(folder / "jobs.sqlite3")) as file:
            file.executescript(dump)
    else:
        with psycopg.connect(url) as db:
            db.execute(dump.encode())


def schema_of(url: str, folder: Path) -> list[str]:
    if url == "sqlite":
        with closing(sqlite3.connect(folder / "jobs.sqlite3")) as file:
            version = file.execute("PRAGMA user_version").fetchone()
            parts = file.execute("SELECT type, name, sql FROM sqlite_master ORDER BY name").fetchall()
        return [str(part) for part in (version, *parts)]
    with psycopg.connect(url) as db:
        version = db.execute("SELECT version FROM sgmethod.version WHERE part = 'jobs'").fetchone()
    programs = find_binaries()
    assert programs is not None
    command = [programs / "pg_dump", "--schema-only", "--schema=sgmethod", "--no-owner", url]
    dump = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
    return [str(version), *(line for line in dump.splitlines() if line and not line.startswith(("--", "\\")))]


@pytest.mark.usefixtures("old_url")
def test_jobs_outlive_an_upgrade(open_job_table: OpenTable) -> None:
    """Those that are done keep their files, and those that waited or ran are encoded."""
    table = open_job_table(NO_TIME_S, webhook_urls="https://app.example/pictures")
    assert {job.id: (job.state, job.owner, job.position) for job in table.page(10)} == {
        DONE: ("done", "ann", None),
        FAILED: ("failed", None, None),
        RUNNING: ("running", "bob", None),
        WAITING: ("queued", None, 1),
        BULK: ("queued", "ann", 2),
    }
    assert job_of(table, DONE).result == FILE
    first = table.first("ann", "the key", "f")
    assert first is not None
    assert first.id == DONE
    assert table.trace(RUNNING) == [{"step": 1}, {"step": 2}]
    counts = table.counts()
    assert (counts.jobs["done"], counts.stored_bytes, counts.totals["finished"]) == (1, 5100, 1)
    assert "encode_seconds" in counts.totals  # a sum of encodes that no histogram counts
    assert (total_of(ENCODING) in counts.totals, max(histogram(counts.totals, ENCODING))[1]) == (False, 0)
    delivery = table.due_delivery("https://app.example/pictures")
    assert delivery is not None
    assert delivery.job_id == DONE
    assert table.reconcile() == []  # the worker of the old service is lost
    assert [claimed(table).id for _ in range(3)] == [WAITING, RUNNING, BULK]
    later = table.submit(new())[0]
    assert later.number == 6
    claim = claimed(table)
    assert table.finish(claim, RESULT)
    assert state(table, later.id) == "done"


def test_an_upgraded_table_is_as_a_new_one(
    old_url: str, open_job_table: OpenTable, tmp_path: Path, new_table: Callable[[], str]
) -> None:
    """Who changes what a new table has, and not what an older one gets, is told here."""
    open_job_table(LONG_S)
    new_url, other = new_table(), tmp_path / "other"
    other.mkdir()
    open_table(new_url, other, LONG_S).close()
    assert schema_of(old_url, tmp_path) == schema_of(new_url, other)


def test_a_migration_that_fails_changes_nothing(
    old_url: str, open_job_table: OpenTable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = schema_of(old_url, tmp_path)
    broken = ("CREATE INDEX more ON jobs (worker)", "CREATE INDEX more ON nothing (worker)")
    monkeypatch.setattr(migrations, "MIGRATIONS", (*migrations.MIGRATIONS, broken))
    with pytest.raises(JobTableError, match="nothing"):
        open_job_table(LONG_S)
    assert schema_of(old_url, tmp_path) == before
    monkeypatch.undo()
    assert state(open_job_table(LONG_S), WAITING) == "queued"


def test_check_upgrades(run_command: RunCommand, old_url: str, tmp_path: Path) -> None:
    result = run_command("check", data_dir=tmp_path, database_url=old_url)
    assert "2 queued, 1 running, 1 done, 1 failed" in result.stdout
    assert "bringing the job table from version 4 to" in result.stderr
    again = run_command("check", data_dir=tmp_path, database_url=old_url)
    assert "bringing" not in again.stderr


@pytest.mark.thorough
def test_a_backup_of_an_older_version_comes_back(postgres: PostgresServer, tmp_path: Path) -> None:
    """With the commands of docs/deploy.md."""
    url, dump, programs = postgres.new_database(), tmp_path / "jobs.dump", find_binaries()
    assert programs is not None
    restore(url, tmp_path)
    subprocess.run([programs / "pg_dump", "--format=custom", "--schema=sgmethod", "--file", dump, url], check=True)
    open_table(url, tmp_path, LONG_S).close()
    back = ["--clean", "--if-exists", "--exit-on-error", f"--dbname={url}", dump]
    subprocess.run([programs / "pg_restore", *back], check=True)
    with closing(open_table(url, tmp_path, LONG_S)) as table:
        assert state(table, WAITING) == "queued"


@pytest.mark.thorough
def test_processes_upgrade_at_once(old_url: str, tmp_path: Path) -> None:
    ids = what_all_say(submit_once, 4, old_url, tmp_path)
    assert (len(ids), len(set(ids))) == (4, 1)
