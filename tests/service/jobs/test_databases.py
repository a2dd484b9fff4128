"""What only the table in PostgreSQL must do, or only the one in SQLite."""

from __future__ import annotations

import shutil
import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import psycopg
import pytest

from service.errors import JobTableError, LimitError, NotSetUpError
from service.jobs import postgres as postgres_table
from service.jobs.job import job_of
from service.jobs.postgres import PostgresJobTable
from service.jobs.sqlite import SqliteJobTable
from service.jobs.table import JobTable
from service.process.loops import StopSignal
from tests.support.job_table import IMAGE, claimed, new, settings, submitted
from tests.support.postgres_server import PostgresServer
from tests.support.processes import TIMEOUT_S, failing

PGBOUNCER = shutil.which("pgbouncer") or shutil.which("pgbouncer", path="/usr/sbin")


@pytest.fixture
def url(postgres: PostgresServer) -> str:
    return postgres.new_database()


@pytest.fixture
def jobs(url: str) -> Iterator[PostgresJobTable]:
    with closing(PostgresJobTable(url, settings())) as jobs:
        yield jobs


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Where a table in SQLite belongs, in a folder of its own."""
    (tmp_path / "data").mkdir()
    return tmp_path / "data" / "jobs.sqlite3"


def assert_delivers(jobs: PostgresJobTable) -> None:
    """Each job wakes a worker at once; what it was called for and does not find does no harm; it ends when asked."""
    stop, taken = StopSignal(), threading.Semaphore(0)

    def run_next() -> bool:
        if jobs.claim("w") is None:
            return False
        taken.release()
        return True

    thread = threading.Thread(target=jobs.dispatch, args=(run_next, stop))
    thread.start()
    for _ in range(3):
        submitted(jobs)
    for _ in range(3):
        assert taken.acquire(timeout=TIMEOUT_S)
    stop.request()
    thread.join(TIMEOUT_S)
    assert not thread.is_alive()
    assert jobs.counts().jobs["running"] == 3


def test_delivery(jobs: PostgresJobTable) -> None:
    assert_delivers(jobs)


@pytest.mark.skipif(PGBOUNCER is None, reason="PgBouncer is not installed: sudo apt install pgbouncer")
def test_behind_a_pooler(postgres: PostgresServer) -> None:
    """One that pools sessions will do. With one that pools transactions, settings of ours would reach others."""
    assert PGBOUNCER is not None
    with postgres.pooled(PGBOUNCER, "session") as url, closing(PostgresJobTable(url, settings())) as jobs:
        assert_delivers(jobs)
    refused = "SG_DATABASE_URL: the pooler is in transaction mode"
    with postgres.pooled(PGBOUNCER, "transaction") as url, pytest.raises(JobTableError, match=refused):
        PostgresJobTable(url, settings())


def test_a_database_without_an_encoding(postgres: PostgresServer) -> None:
    """As a cluster made in the C locale has it: it worked once, and never again."""
    url = postgres.new_database("ENCODING 'SQL_ASCII' LC_COLLATE 'C' LC_CTYPE 'C' TEMPLATE template0")
    for _ in range(2):
        with closing(PostgresJobTable(url, settings())) as jobs:
            submitted(jobs)


def tokens(url: str, schema: str = postgres_table.ENGINE_TABLES) -> int:
    with psycopg.connect(url) as db:
        return len(db.execute(f"SELECT FROM {schema}.procrastinate_jobs".encode()).fetchall())


def test_rule_1_row_and_engine_job_are_one_transaction(
    url: str, jobs: PostgresJobTable, monkeypatch: pytest.MonkeyPatch
) -> None:
    submitted(jobs)
    assert (jobs.queued(), tokens(url)) == (1, 1)
    broken = failing(job_of, psycopg.OperationalError("broken off"))
    monkeypatch.setattr("service.jobs.table.job_of", broken)  # the last step of the transaction
    with pytest.raises(JobTableError, match="broken off"):
        submitted(jobs)
    assert (jobs.queued(), tokens(url)) == (1, 1)


def test_rule_6_durability_settings_of_postgresql(jobs: PostgresJobTable) -> None:
    with jobs._connection() as db:
        names = ("synchronous_commit", "idle_in_transaction_session_timeout", "search_path")
        values = [next(iter(db.execute(f"SHOW {name}").fetchone().values())) for name in names]
    assert values == ["on", "10s", f"sgmethod, {postgres_table.ENGINE_TABLES}"]


def test_rule_6_durability_settings_of_sqlite(path: Path) -> None:
    with closing(SqliteJobTable(path, settings())) as table, table._connection() as db:
        names = ("journal_mode", "synchronous", "foreign_keys", "busy_timeout")
        values = [db.execute(f"PRAGMA {name}").fetchone()[0] for name in names]
    assert values == ["wal", 2, 1, 30_000]


def test_a_standby_answers_but_takes_no_changes(url: str, jobs: PostgresJobTable) -> None:
    """As the primary that a failover has made one."""
    jobs.check_writable()
    with psycopg.connect(url, autocommit=True) as other:
        name = other.execute("SELECT current_database()").fetchone()[0]  # type: ignore[index]
        other.execute(f'ALTER DATABASE "{name}" SET default_transaction_read_only = on'.encode())
        others = "FROM pg_stat_activity WHERE pid <> pg_backend_pid() AND datname = %s"
        other.execute(f"SELECT pg_terminate_backend(pid) {others}".encode(), [name])
    with pytest.raises(JobTableError, match="read-only"):
        jobs.check_writable()
    assert jobs.counts().deliveries == 0


def test_a_lock_that_is_held_is_no_read_only_disk(path: Path) -> None:
    with closing(SqliteJobTable(path, settings())) as jobs:
        with closing(sqlite3.connect(path, isolation_level=None)) as other:
            other.execute("BEGIN IMMEDIATE")
            jobs.check_writable()
        path.unlink()
        with pytest.raises(JobTableError, match="No such file"):
            jobs.check_writable()
        assert not path.exists()


def test_versions_of_the_engine_run_side_by_side(
    url: str, jobs: PostgresJobTable, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The start of another, or its health check, dropped what running processes used."""
    ours = postgres_table.ENGINE_TABLES
    first = submitted(jobs)  # on the only connection that it will ever need
    session = postgres_table.SESSION.replace(postgres_table.ENGINE_TABLES.encode(), b"sgmethod_engine_0_1")
    monkeypatch.setattr(postgres_table, "ENGINE_TABLES", "sgmethod_engine_0_1")
    monkeypatch.setattr(postgres_table, "SESSION", session)
    with closing(PostgresJobTable(url, settings())) as other:
        second, third = submitted(jobs), submitted(other)
        for _ in range(2):
            jobs._top_up()
            other._top_up()
        for schema in (ours, "sgmethod_engine_0_1"):
            assert tokens(url, schema) >= 3  # one too many ends at once
        assert [claimed(table).id for table in (other, jobs, other)] == [first, second, third]


def test_a_look_sets_nothing_up(url: str, path: Path) -> None:
    for look in (
        lambda: PostgresJobTable(url, settings(), sets_up=False),
        lambda: SqliteJobTable(path, settings(), sets_up=False),
    ):
        with pytest.raises(NotSetUpError, match="the first start of the service makes it"):
            look()
    assert not path.exists()
    with psycopg.connect(url) as db:
        found = db.execute("SELECT nspname FROM pg_namespace WHERE nspname LIKE 'sgmethod%'").fetchall()
    assert found == []


def outdate(db: Any, *drops: str) -> None:
    """Take from a job table what version 3 did not have."""
    for statement in (*drops, "DROP TABLE stored", "ALTER TABLE jobs DROP COLUMN losses"):
        db.execute(statement)


def assert_upgraded(open_table: Callable[..., JobTable], job_id: str) -> None:
    with pytest.raises(NotSetUpError, match="of version 3; the next start of the service upgrades it to version 4"):
        open_table(sets_up=False)
    for _ in range(2):
        with closing(open_table()) as table:
            assert table.counts().jobs == {"queued": 1, "running": 0, "done": 0, "failed": 0}
            assert table.counts().stored_bytes == IMAGE.size_bytes
    with closing(open_table()) as table:
        assert claimed(table).id == job_id
        assert table.counts().jobs == {"queued": 0, "running": 1, "done": 0, "failed": 0}


def test_an_earlier_version_is_upgraded_in_postgresql(url: str, jobs: PostgresJobTable) -> None:
    job_id = submitted(jobs)
    with psycopg.connect(url, options="-c search_path=sgmethod") as db:
        outdate(db, *(f"DROP FUNCTION count_{event} CASCADE" for event in ("insert", "update", "delete")))
        db.execute("UPDATE version SET version = '3' WHERE part = 'jobs'")
    assert_upgraded(partial(PostgresJobTable, url, settings()), job_id)


def test_an_earlier_version_is_upgraded_in_sqlite(path: Path) -> None:
    with closing(SqliteJobTable(path, settings())) as table:
        job_id = submitted(table)
    with closing(sqlite3.connect(path)) as file:
        outdate(file, *(f"DROP TRIGGER jobs_{event}" for event in ("come", "go", "change")))
        file.execute("PRAGMA user_version = 3")
    assert_upgraded(partial(SqliteJobTable, path, settings()), job_id)


def test_counts_and_quotas_take_no_longer_with_many_jobs(path: Path) -> None:
    """Each read the whole table: 0.3 s of a probe without a key, or of a POST with the lock held, at 100,000 jobs."""
    steps: list[int] = []

    def asked(table: SqliteJobTable) -> int:
        steps.clear()
        table.counts()
        with pytest.raises(LimitError, match="storage quota"):
            table.submit(new(owner="ann"))
        return len(steps)

    with closing(SqliteJobTable(path, settings(quota_bytes_per_key=IMAGE.size_bytes))) as table:
        submitted(table, owner="ann")
        with table._connection() as db:  # the one that every later call takes
            db.set_progress_handler(lambda: steps.append(1), 1)
        few = asked(table)
        claimed(table)
        for _ in range(300):
            submitted(table)
            claimed(table)
        assert asked(table) < 1.5 * few


def test_a_table_of_a_later_version_in_postgresql(url: str, jobs: PostgresJobTable) -> None:
    with psycopg.connect(url) as db:
        db.execute("UPDATE sgmethod.version SET version = '99' WHERE part = 'jobs'")
    with pytest.raises(JobTableError, match="of version 99, and this service reads versions 3 and 4"):
        PostgresJobTable(url, settings())
    assert jobs.queued() == 0


def test_a_table_of_a_later_version_in_sqlite(path: Path) -> None:
    SqliteJobTable(path, settings()).close()
    with closing(sqlite3.connect(path)) as file:
        file.execute("PRAGMA user_version = 99")
    with pytest.raises(JobTableError, match="of version 99, and this service reads versions 3 and 4"):
        SqliteJobTable(path, settings())


def test_a_file_that_is_no_table(path: Path) -> None:
    path.write_bytes(b"this is not a database" * 100)
    with pytest.raises(JobTableError, match="not a database"):
        SqliteJobTable(path, settings())


def test_a_file_that_is_removed_or_replaced(path: Path, tmp_path: Path) -> None:
    """Nothing is accepted into a file that no other process sees."""
    with closing(SqliteJobTable(path, settings())) as table:
        first = submitted(table)
        path.parent.rename(tmp_path / "aside")
        with pytest.raises(JobTableError, match="No such file"):
            submitted(table)
        path.parent.mkdir()
        path.touch()
        second = submitted(table)
        with closing(SqliteJobTable(path, settings())) as other:
            assert [job.id for job in other.page(10)] == [second]
        shutil.rmtree(path.parent)
        (tmp_path / "aside").rename(path.parent)
        assert [job.id for job in table.page(10)] == [first]
