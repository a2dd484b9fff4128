"""What only the table in SQLite must do."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import pytest

from service.jobs.job import JobTableError
from service.jobs.sqlite import SqliteJobTable
from tests.harness.job_table import RULES, submitted


def test_a_table_that_cannot_be_read(tmp_path: Path) -> None:
    path = tmp_path / "jobs.sqlite3"
    path.write_bytes(b"this is not a database" * 100)
    with pytest.raises(JobTableError, match="not a database"):
        SqliteJobTable(path, RULES)


def test_a_table_of_a_later_version(tmp_path: Path) -> None:
    path = tmp_path / "jobs.sqlite3"
    SqliteJobTable(path, RULES).close()
    database = sqlite3.connect(path)
    database.execute("PRAGMA user_version = 99")
    database.close()
    with pytest.raises(JobTableError, match="another version"):
        SqliteJobTable(path, RULES)


def test_a_table_that_is_removed_or_replaced(tmp_path: Path) -> None:
    """Nothing is accepted into a file that nobody else sees."""
    folder, aside = tmp_path / "data", tmp_path / "aside"
    folder.mkdir()
    table = SqliteJobTable(folder / "jobs.sqlite3", RULES)
    first = submitted(table)
    folder.rename(aside)
    with pytest.raises(JobTableError, match="No such file"):
        submitted(table)
    folder.mkdir()
    (folder / "jobs.sqlite3").touch()
    second = submitted(table)
    other = SqliteJobTable(folder / "jobs.sqlite3", RULES)
    assert [job.id for job in other.page(10)] == [second]
    shutil.rmtree(folder)
    aside.rename(folder)
    assert [job.id for job in table.page(10)] == [first]
    table.close()
    other.close()


def test_rule_6_durability_settings(tmp_path: Path) -> None:
    table = SqliteJobTable(tmp_path / "jobs.sqlite3", RULES)
    with table._connection() as db:
        values = {
            name: db.execute(f"PRAGMA {name}").fetchone()[0]
            for name in ("journal_mode", "synchronous", "foreign_keys", "busy_timeout")
        }
    assert values == {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1, "busy_timeout": 30_000}
    table.close()
