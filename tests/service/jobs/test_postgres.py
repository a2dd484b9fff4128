"""What only the table in PostgreSQL must do."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator

import psycopg
import pytest

from service.jobs.job import JobTableError
from service.jobs.postgres import PostgresJobTable
from service.process.loops import StopSignal
from tests.harness.job_table import RULES, claimed, submitted
from tests.harness.postgres_server import PostgresServer
from tests.harness.processes import PATIENCE_S

PGBOUNCER = shutil.which("pgbouncer") or shutil.which("pgbouncer", path="/usr/sbin")


@pytest.fixture
def url(postgres: PostgresServer) -> str:
    return postgres.new_database()


@pytest.fixture
def jobs(url: str) -> Iterator[PostgresJobTable]:
    jobs = PostgresJobTable(url, RULES)
    yield jobs
    jobs.close()


@pytest.mark.skipif(PGBOUNCER is None, reason="PgBouncer is not installed: sudo apt install pgbouncer")
def test_behind_a_pooler(postgres: PostgresServer) -> None:
    """One that pools sessions will do. With one that pools transactions, settings of ours would reach others."""
    assert PGBOUNCER is not None
    with postgres.pooled(PGBOUNCER, "session") as url:
        jobs = PostgresJobTable(url, RULES)
        stop, woken = StopSignal(), threading.Event()
        thread = threading.Thread(target=jobs.deliver, args=(lambda: woken.set() or False, stop))
        thread.start()
        submitted(jobs)
        assert woken.wait(PATIENCE_S)
        stop.request()
        thread.join(PATIENCE_S)
        jobs.close()
    with (
        postgres.pooled(PGBOUNCER, "transaction") as url,
        pytest.raises(JobTableError, match="SG_DATABASE_URL: the pooler is in transaction mode"),
    ):
        PostgresJobTable(url, RULES)


def test_a_database_without_an_encoding(postgres: PostgresServer) -> None:
    """As a cluster made in the C locale has it: it worked once, and never again."""
    url = postgres.new_database("ENCODING 'SQL_ASCII' LC_COLLATE 'C' LC_CTYPE 'C' TEMPLATE template0")
    for _ in range(2):
        jobs = PostgresJobTable(url, RULES)
        submitted(jobs)
        jobs.close()


def tokens(url: str) -> int:
    with psycopg.connect(url) as db:
        row = db.execute("SELECT count(*) FROM sgmethod_engine.procrastinate_jobs").fetchone()
    assert row is not None
    return int(row[0])


def test_rule_1_row_and_engine_job_are_one_transaction(
    url: str, jobs: PostgresJobTable, monkeypatch: pytest.MonkeyPatch
) -> None:
    submitted(jobs)
    assert (jobs.queued(), tokens(url)) == (1, 1)

    def break_off(_row: object) -> None:
        raise psycopg.OperationalError("broken off")

    monkeypatch.setattr("service.jobs.table.job_of", break_off)  # the last step of the transaction
    with pytest.raises(JobTableError, match="broken off"):
        submitted(jobs)
    assert (jobs.queued(), tokens(url)) == (1, 1)


def test_rule_6_durability_settings(jobs: PostgresJobTable) -> None:
    with jobs._connection() as db:
        names = ("synchronous_commit", "idle_in_transaction_session_timeout", "search_path")
        values = [next(iter(db.execute(f"SHOW {name}").fetchone().values())) for name in names]
    assert values == ["on", "10s", "sgmethod, sgmethod_engine"]


def test_another_version_of_the_engine_starts_afresh(url: str, jobs: PostgresJobTable) -> None:
    """Its jobs are made anew from the table."""
    job_id = submitted(jobs)
    with psycopg.connect(url) as db:
        db.execute("UPDATE sgmethod.version SET version = '0.1' WHERE part = 'engine'")
    later = PostgresJobTable(url, RULES)
    assert tokens(url) == 0
    later._top_up()
    later._top_up()
    assert tokens(url) == 1
    assert claimed(later).job_id == job_id
    later.close()


def test_a_table_of_a_later_version(url: str, jobs: PostgresJobTable) -> None:
    with psycopg.connect(url) as db:
        db.execute("UPDATE sgmethod.version SET version = '99' WHERE part = 'jobs'")
    with pytest.raises(JobTableError, match="another version"):
        PostgresJobTable(url, RULES)
    assert jobs.queued() == 0


def test_delivery_wakes_at_once_and_ends_when_told(jobs: PostgresJobTable) -> None:
    """Each job is announced by a call; what was called for nothing does no harm."""
    stop, taken = StopSignal(), threading.Semaphore(0)

    def run_next() -> bool:
        if jobs.claim("w") is None:
            return False
        taken.release()
        return True

    thread = threading.Thread(target=jobs.deliver, args=(run_next, stop))
    thread.start()
    for _ in range(3):
        submitted(jobs)
    for _ in range(3):
        assert taken.acquire(timeout=PATIENCE_S)
    stop.request()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()
    assert jobs.census().jobs["running"] == 3
