"""What only the table in SQLite must do."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
from pathlib import Path

import pytest

from service.jobs.sqlite import SqliteJobTable
from service.jobs.table import JobTableError
from tests.harness.job_table import (
    RESULT,
    RULES,
    claimed,
    submitted,
)


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
    with pytest.raises(JobTableError, match="newer"):
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


def test_a_table_of_version_1_is_brought_up_to_date(tmp_path: Path) -> None:
    path = tmp_path / "jobs.sqlite3"
    database = sqlite3.connect(path)
    database.executescript((Path(__file__).parent / "jobs_version_1.sql").read_text())
    database.close()
    for _ in range(2):  # the second time there is nothing left to do
        table = SqliteJobTable(path, RULES)
        waiting, done = table.page(10)
        assert (waiting.number, waiting.state, waiting.owner, waiting.priority) == (7, "queued", None, "interactive")
        assert (done.number, done.state, done.result) == (5, "done", RESULT)
        assert table.trace(done.id) == [{"step": 0}, {"step": 1}]
        assert table.find_by_key("key") == waiting
        table.close()
    database = sqlite3.connect(path)
    tables = {name for (name,) in database.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")}
    database.close()
    assert tables == {"jobs", "trace", "served", "workers", "notices", "sqlite_sequence"}


def test_rule_6_durability_settings(tmp_path: Path) -> None:
    table = SqliteJobTable(tmp_path / "jobs.sqlite3", RULES)
    with table._connection() as db:
        values = {
            name: db.execute(f"PRAGMA {name}").fetchone()[0]
            for name in ("journal_mode", "synchronous", "foreign_keys", "busy_timeout")
        }
    assert values == {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1, "busy_timeout": 30_000}
    table.close()


@pytest.mark.parametrize(
    ("version", "missing"), [(2, ("stored_bytes", "stopped")), (3, ("stopped",)), (4, ()), (5, ())]
)
def test_a_table_of_a_later_version_is_brought_up_to_date(
    tmp_path: Path, version: int, missing: tuple[str, ...]
) -> None:
    """Version 2 did not count bytes; in version 3 nothing could be stopped; 4 knew of no
    workers, 5 of no webhooks.
    """
    path = tmp_path / "jobs.sqlite3"
    table = SqliteJobTable(path, RULES)
    waiting = submitted(table)
    table.close()
    with contextlib.closing(sqlite3.connect(path)) as connection, connection as db:
        for column in missing:
            db.execute(f"ALTER TABLE jobs DROP COLUMN {column}")
        db.execute("DROP TABLE notices")
        if version < 5:
            db.execute("DROP TABLE workers")
        db.execute(f"PRAGMA user_version = {version}")
    table = SqliteJobTable(path, RULES)
    job = table.get(waiting)
    assert job is not None
    assert table.stored_bytes() == job.image.size_bytes > 0
    claimed(table)
    assert table.stop(waiting)
    table.sign("one")
    assert list(table.census().workers) == ["one"]
    table.close()
