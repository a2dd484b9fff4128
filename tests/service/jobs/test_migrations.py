"""Changes to the tables of a released version, tried with one that a test makes up."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import psycopg
import pytest

from service.errors import JobTableError
from service.jobs import migrations
from tests.service.jobs.test_table import submit_once
from tests.support.job_table import LONG_S, RESULT, OpenTable, claimed, open_table, state, submitted, what_all_say

NEWER = migrations.NEWEST_VERSION + 1
COLUMN = "ALTER TABLE jobs ADD COLUMN more TEXT NOT NULL DEFAULT 'x'"


def version_of(url: str, folder: Path) -> int:
    if url == "sqlite":
        with closing(sqlite3.connect(folder / "jobs.sqlite3")) as file:
            return int(file.execute("PRAGMA user_version").fetchone()[0])
    with psycopg.connect(url) as db:
        return int(db.execute("SELECT version FROM sgmethod.version WHERE part = 'jobs'").fetchone()[0])  # type: ignore[index]


def add_version(monkeypatch: pytest.MonkeyPatch, *statements: str) -> None:
    monkeypatch.setattr(migrations, "MIGRATIONS", (*migrations.MIGRATIONS, statements))
    for module in ("migrations", "postgres"):
        monkeypatch.setattr(f"service.jobs.{module}.NEWEST_VERSION", NEWER)


def test_jobs_outlive_an_upgrade(
    open_job_table: OpenTable, database_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = open_job_table(LONG_S)
    first, second = (submitted(old) for _ in range(2))
    assert claimed(old).id == first
    add_version(monkeypatch, COLUMN)
    new = open_job_table(LONG_S)
    assert (state(new, first), state(new, second)) == ("running", "queued")
    assert version_of(database_url, tmp_path) == NEWER
    assert new.finish(claimed(new), RESULT)


def test_a_migration_that_fails_changes_nothing(
    open_job_table: OpenTable, database_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waiting = submitted(open_job_table(LONG_S))
    before = version_of(database_url, tmp_path)
    add_version(monkeypatch, COLUMN, "CREATE INDEX more ON nothing (worker)")
    with pytest.raises(JobTableError, match="nothing"):
        open_job_table(LONG_S)
    monkeypatch.undo()
    assert version_of(database_url, tmp_path) == before
    assert state(open_job_table(LONG_S), waiting) == "queued"


@pytest.mark.thorough
def test_processes_make_the_tables_at_once(database_url: str, tmp_path: Path) -> None:
    ids = what_all_say(submit_once, 4, database_url, tmp_path)
    assert (len(ids), len(set(ids))) == (4, 1)
    open_table(database_url, tmp_path, LONG_S).close()
