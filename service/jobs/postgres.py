"""The job table in PostgreSQL, for workers on several machines."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import procrastinate
import psycopg
from procrastinate.exceptions import ProcrastinateException
from psycopg.conninfo import make_conninfo
from psycopg.rows import DictRow, dict_row
from psycopg_pool import ConnectionPool

from service.errors import JobTableError, NotSetUpError
from service.jobs.engine import PATIENCE_S, SCHEMA as ENGINE_SCHEMA, Engine, in_words
from service.jobs.statements import (
    COUNT_ALL,
    OLDEST_VERSION,
    OVERDUE,
    SCHEMA,
    SCHEMA_VERSION,
    TO_BE_MADE,
    UPGRADE,
    Database,
    other_version,
    to_be_upgraded,
)
from service.jobs.table import WATCHED, JobTable
from service.process.loops import StopSignal
from service.settings import Settings

NUMBER = "BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY"
# The database's clock, because clocks of several machines differ.
EPOCH = """
CREATE FUNCTION epoch() RETURNS DOUBLE PRECISION LANGUAGE sql VOLATILE
AS 'SELECT extract(epoch FROM clock_timestamp())::DOUBLE PRECISION';
"""
# By statement, not by row: COPY of many jobs would change the same row again and again in one transaction, whose time
# grows with the square. In the order of the keys, so that no two transactions wait for each other.
CAME = "SELECT owner, state, 1 AS jobs, image_bytes + file_bytes AS bytes FROM came"
GONE = "SELECT owner, state, -1 AS jobs, -image_bytes - file_bytes AS bytes FROM gone"
TRIGGERS = "".join(
    f"""
CREATE FUNCTION count_{event}() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
    INSERT INTO sgmethod.stored
    SELECT owner, state, sum(jobs), sum(bytes) FROM ({changes}) AS changes
    GROUP BY owner, state HAVING sum(jobs) <> 0 OR sum(bytes) <> 0 ORDER BY owner, state
    ON CONFLICT (owner, state) DO UPDATE SET jobs = stored.jobs + excluded.jobs, bytes = stored.bytes + excluded.bytes;
    RETURN NULL;
END $$;
CREATE TRIGGER count_{event} AFTER {event} ON jobs REFERENCING {tables}
FOR EACH STATEMENT EXECUTE FUNCTION count_{event}();
"""
    for event, tables, changes in (
        ("insert", "NEW TABLE AS came", CAME),
        ("delete", "OLD TABLE AS gone", GONE),
        ("update", "NEW TABLE AS came OLD TABLE AS gone", f"{CAME} UNION ALL {GONE}"),
    )
)
# Our tables and the engine's have their own schemas, and each version of the engine has one: processes of two versions
# may run side by side, since every worker makes tokens from the job table. A worker that is stopped within a
# transaction must not keep its locks. PgBouncer refuses these as startup parameters.
ENGINE_TABLES = "sgmethod_engine_" + re.sub(r"\W", "_", procrastinate.__version__)
SESSION = f"""
SET search_path = sgmethod, {ENGINE_TABLES};
SET synchronous_commit = on;
SET idle_in_transaction_session_timeout = '10s';
""".encode()
CONNECT: dict[str, str | int] = {
    "connect_timeout": 5,
    "keepalives_idle": 10,
    "tcp_user_timeout": 15_000,
    "application_name": "sgmethod",
    "client_encoding": "utf8",  # else a database in SQL_ASCII would return text as bytes
}
CONNECTIONS = 8
SET_UP_LOCK, QUEUE_LOCK, TOP_UP_LOCK = 0x5367_0001, 0x5367_0002, 0x5367_0003
CLAIMABLE = f"""
SELECT (SELECT count(*) FROM jobs WHERE state = 'queued') + (SELECT count(*) FROM jobs {OVERDUE}) AS jobs
"""


class _Session:
    """A connection that takes statements in the form of statements.py."""

    def __init__(self, connection: psycopg.Connection[DictRow]) -> None:
        self.connection = connection

    def execute(self, statement: str, values: Sequence[Any] = (), /) -> Any:
        return self.connection.execute(statement.replace("?", "%s").encode(), values or None)


def _begin_session(connection: psycopg.Connection[DictRow]) -> None:
    connection.execute(SESSION)


@contextmanager
def _translated_errors() -> Iterator[None]:
    try:
        yield
    except (psycopg.Error, ProcrastinateException) as error:
        raise JobTableError(f"PostgreSQL: {in_words(error)}") from error


def _set_up_jobs(db: psycopg.Connection[DictRow], upgrades: bool) -> bool:
    """Create or upgrade our tables. Returns whether there were none. Raises NotSetUpError unless it upgrades."""
    db.execute("CREATE SCHEMA IF NOT EXISTS sgmethod")
    db.execute("CREATE TABLE IF NOT EXISTS version (part TEXT PRIMARY KEY, version TEXT NOT NULL)")
    row = db.execute("SELECT version FROM version WHERE part = 'jobs'").fetchone()
    version = int(row["version"]) if row else 0
    if version == SCHEMA_VERSION:
        return False
    if version not in (0, OLDEST_VERSION):
        raise JobTableError(other_version(version))
    if version and not upgrades:  # nor is it tried, as it locks the jobs
        raise NotSetUpError(f"PostgreSQL: {to_be_upgraded(version)}")
    tables = UPGRADE if version else f"{EPOCH} {SCHEMA.format(number=NUMBER)}"
    db.execute(f"{tables} {TRIGGERS} {COUNT_ALL}".encode())
    db.execute(
        "INSERT INTO version VALUES ('jobs', %s) ON CONFLICT (part) DO UPDATE SET version = excluded.version",
        (str(SCHEMA_VERSION),),
    )
    return not version


def _set_up_engine(db: psycopg.Connection[DictRow]) -> None:
    """Create the tables of this version of the engine if there are none."""
    known = db.execute("SELECT to_regclass(%s) AS jobs", (f"{ENGINE_TABLES}.procrastinate_jobs",)).fetchone()
    if known is None or known["jobs"] is None:
        db.execute(f"CREATE SCHEMA IF NOT EXISTS {ENGINE_TABLES}".encode())
        db.execute(f"SET LOCAL search_path = {ENGINE_TABLES}".encode())
        db.execute(ENGINE_SCHEMA.encode())


class PostgresJobTable(JobTable):
    """A job table in a PostgreSQL database.

    url: postgresql://user:password@host/database, or another form that libpq understands; sets_up: whether to create or
    upgrade the tables, instead of raising NotSetUpError.
    """

    def __init__(self, url: str, settings: Settings, *, sets_up: bool = True) -> None:
        super().__init__(settings)
        try:
            conninfo = make_conninfo(url, **CONNECT)
        except psycopg.Error:  # its message may contain the password
            raise JobTableError("SG_DATABASE_URL cannot be read; its password must be percent-encoded") from None
        try:
            with _translated_errors():
                self._set_up(conninfo, sets_up)
        except NotSetUpError:
            raise
        except JobTableError as error:
            variables = ["SG_DATABASE_URL", *sorted(name for name in os.environ if name.startswith("PG"))]
            raise JobTableError(f"{', '.join(variables)}: {error}") from error
        logging.getLogger("psycopg.pool").setLevel(logging.ERROR)  # it logs a warning for each try to reconnect
        # Each connection is checked when it is taken, since a restart of the database breaks it.
        self._pool = ConnectionPool(
            conninfo,
            kwargs={"autocommit": True, "row_factory": dict_row},
            configure=_begin_session,
            min_size=1,
            max_size=CONNECTIONS,
            timeout=PATIENCE_S,
            reconnect_timeout=PATIENCE_S,  # else pauses between tries grow to minutes
            check=ConnectionPool.check_connection,
            open=True,
            connection_class=psycopg.Connection[DictRow],
        )
        self._engine = Engine(self._pool, conninfo, settings.lease_s, SESSION)

    @staticmethod
    def _set_up(conninfo: str, lasting: bool) -> None:
        """Create or upgrade tables where that is needed. If it shall not be `lasting`, it is tried and undone.

        This does not use the pool, so a wrong address is reported at once.
        """
        session_id = "SELECT pg_backend_pid()"
        with psycopg.connect(conninfo, autocommit=True) as other, psycopg.connect(conninfo, row_factory=dict_row) as db:
            before = other.execute(session_id).fetchone()
            # This begins a transaction, which a pooler in transaction mode runs in the session that `other` just left.
            db.execute(SESSION)
            if other.execute(session_id).fetchone() != before:
                raise JobTableError("the pooler is in transaction mode; let it pool sessions, or connect directly")
            db.execute("SELECT pg_advisory_xact_lock(%s)", (SET_UP_LOCK,))
            if _set_up_jobs(db, lasting) and not lasting:
                raise NotSetUpError(f"PostgreSQL: {TO_BE_MADE}")  # which rolls back
            if lasting:
                _set_up_engine(db)

    @contextmanager
    def _connection(self) -> Iterator[_Session]:
        with _translated_errors(), self._pool.connection() as db:
            yield _Session(db)

    @contextmanager
    def _transaction(self) -> Iterator[_Session]:
        with self._connection() as db, db.connection.transaction():
            yield db

    def _alone(self, db: Database) -> None:
        db.execute("SELECT pg_advisory_xact_lock(?)", (QUEUE_LOCK,))

    def _wake(self, db: Database) -> None:
        assert isinstance(db, _Session)
        self._engine.defer(db.connection)

    def dispatch(self, run_next: Callable[[], bool], stop: StopSignal) -> None:
        self._engine.dispatch(run_next, self._top_up, stop)

    def _top_up(self) -> None:
        """Add tokens until there is one for each row that a worker could claim or reconcile."""
        lease_s = self._settings.lease_s
        with self._transaction() as db:
            if not db.execute("SELECT pg_try_advisory_xact_lock(?) AS ours", (TOP_UP_LOCK,)).fetchone()["ours"]:
                return  # another worker is doing it
            rows = db.execute(CLAIMABLE, (WATCHED * lease_s, lease_s)).fetchone()["jobs"]
            for _ in range(rows - self._engine.waiting()):
                self._wake(db)

    def check_writable(self) -> None:
        with self._connection() as db:
            if db.execute("SHOW transaction_read_only").fetchone()["transaction_read_only"] == "on":
                raise JobTableError("PostgreSQL is read-only, as a standby is; let SG_DATABASE_URL lead to the primary")

    def close(self) -> None:
        self._pool.close()
