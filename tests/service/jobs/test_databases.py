"""What only the table in PostgreSQL must do, or only the one in SQLite."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path

import psycopg
import pytest

from service.errors import JobTableError, LimitError
from service.jobs.postgres import PostgresJobTable
from service.jobs.sqlite import SqliteJobTable
from service.jobs.table import JobTable
from tests.support.job_table import IMAGE, change, claimed, job_of, new, settings, submitted
from tests.support.postgres_server import PostgresServer

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


@pytest.mark.skipif(PGBOUNCER is None, reason="PgBouncer is not installed: sudo apt install pgbouncer")
def test_behind_a_pooler(postgres: PostgresServer) -> None:
    """One that pools sessions will do. With one that pools transactions, settings of ours would reach others."""
    assert PGBOUNCER is not None
    with postgres.pooled(PGBOUNCER, "session") as url, closing(PostgresJobTable(url, settings())) as jobs:
        submitted(jobs)
        assert claimed(jobs).attempt == 1
    refused = "SG_DATABASE_URL: the pooler is in transaction mode"
    with postgres.pooled(PGBOUNCER, "transaction") as url, pytest.raises(JobTableError, match=refused):
        PostgresJobTable(url, settings())


def test_a_database_without_an_encoding(postgres: PostgresServer) -> None:
    """As a cluster made in the C locale has it: it worked once, and never again."""
    url = postgres.new_database("ENCODING 'SQL_ASCII' LC_COLLATE 'C' LC_CTYPE 'C' TEMPLATE template0")
    for _ in range(2):
        with closing(PostgresJobTable(url, settings())) as jobs:
            submitted(jobs)


def test_rule_6_durability_settings_of_postgresql(jobs: PostgresJobTable) -> None:
    with jobs._connection() as db:
        names = ("synchronous_commit", "idle_in_transaction_session_timeout", "search_path")
        values = [next(iter(db.execute(f"SHOW {name}").fetchone().values())) for name in names]
    assert values == ["on", "10s", "sgmethod"]


def test_rule_6_durability_settings_of_sqlite(path: Path) -> None:
    with closing(SqliteJobTable(path, settings())) as table, table._connection() as db:
        names = ("journal_mode", "synchronous", "foreign_keys", "busy_timeout")
        values = [db.execute(f"PRAGMA {name}").fetchone()[0] for name in names]
    assert values == ["wal", 2, 1, 30_000]


@pytest.mark.parametrize("attempt", [JobTable.check_writable, submitted])
def test_a_standby_answers_but_takes_no_changes(
    url: str, jobs: PostgresJobTable, attempt: Callable[[JobTable], object]
) -> None:
    """As the primary that a failover has made one. Once the address leads to the new one, changes soon succeed.

    Sessions on the old one stayed for up to an hour. Some may be about to begin there when the address changes.
    """

    def succeeds() -> bool:
        with suppress(JobTableError):
            attempt(jobs)
            return True
        return False

    assert succeeds()
    before = jobs.counts().jobs
    with psycopg.connect(url, autocommit=True) as other:
        name = other.execute("SELECT current_database()").fetchone()[0]  # type: ignore[index]
        other.execute(f'ALTER DATABASE "{name}" SET default_transaction_read_only = on'.encode())
        others = "FROM pg_stat_activity WHERE pid <> pg_backend_pid() AND datname = %s"
        other.execute(f"SELECT pg_terminate_backend(pid, 10000) {others}".encode(), [name])
        for _ in range(3):
            with pytest.raises(JobTableError, match=r"^PostgreSQL is read-only, .* name the primary$"):
                attempt(jobs)
            assert jobs.counts().jobs == before
        other.execute(f'ALTER DATABASE "{name}" RESET default_transaction_read_only'.encode())
    assert all([succeeds() for _ in range(10)][5:])


def test_a_lock_that_is_held_is_no_read_only_disk(path: Path) -> None:
    with closing(SqliteJobTable(path, settings())) as jobs:
        with closing(sqlite3.connect(path, isolation_level=None)) as other:
            other.execute("BEGIN IMMEDIATE")
            jobs.check_writable()
        path.unlink()
        with pytest.raises(JobTableError, match="No such file"):
            jobs.check_writable()
        assert not path.exists()


def test_nothing_reads_the_whole_table_or_queue(path: Path) -> None:
    """With 100,000 jobs, probes and quotas took 0.3 s; with 20,000 queued ones, a claim took 0.14 s."""
    steps: list[int] = []

    def asked(table: SqliteJobTable, job_id: str) -> int:
        steps.clear()
        table.counts()
        table.check_queue("key bob", "bob")
        with pytest.raises(LimitError, match="storage quota"):
            table.submit(new(owner="ann"))
        assert table.get(job_id)
        claimed(table)
        return len(steps)

    limits = settings(quota_bytes_per_key=5 * IMAGE.bytes, queue_length=100_000)
    with closing(SqliteJobTable(path, limits)) as table:
        for owner in 5 * ("ann", "bob"):
            submitted(table, owner=owner)
        for _ in range(2):
            claimed(table)
        with table._connection() as db:  # the one that every later call takes
            db.set_progress_handler(lambda: steps.append(1), 1)
        few = asked(table, table.page(1)[0].id)
        grown = "owner, state, fingerprint, request, image, created_at, image_bytes"
        numbers = "WITH RECURSIVE numbers AS (SELECT 1 AS n UNION ALL SELECT n + 1 FROM numbers WHERE n < 300)"
        change(table, f"INSERT INTO jobs (id, {grown}) {numbers} SELECT n || id, {grown} FROM numbers, jobs")
        newest = table.page(1)[0].id
        assert asked(table, newest) < 1.5 * few
        steps.clear()
        table.page(10)
        assert len(steps) < 10 * few
        steps.clear()
        assert table.position(job_of(table, newest)) > 1000  # which looks at each job before it, and is asked for one
        assert len(steps) < 20_000


# A version that this service does not read, and what to do then.
OTHERS = pytest.mark.parametrize(
    ("version", "words"),
    [
        (99, "has version 99, and this service reads versions 9 to 9; install the service that wrote it"),
        (8, "has version 8, that of a release candidate; start with an empty data folder, or an empty database and"),
    ],
)


@OTHERS
def test_a_table_of_another_version_in_postgresql(url: str, jobs: PostgresJobTable, version: int, words: str) -> None:
    with psycopg.connect(url) as db:
        db.execute("UPDATE sgmethod.version SET version = %s WHERE part = 'jobs'", (str(version),))
    with pytest.raises(JobTableError, match=words):
        PostgresJobTable(url, settings())
    assert jobs.queued() == 0


@OTHERS
def test_a_table_of_another_version_in_sqlite(path: Path, version: int, words: str) -> None:
    SqliteJobTable(path, settings()).close()
    with closing(sqlite3.connect(path)) as file:
        file.execute(f"PRAGMA user_version = {version}")
    with pytest.raises(JobTableError, match=words):
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
