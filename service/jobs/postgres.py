"""The job table in PostgreSQL, for workers on several machines."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import procrastinate
import psycopg
from procrastinate.exceptions import ProcrastinateException
from psycopg.conninfo import make_conninfo
from psycopg.rows import DictRow, dict_row
from psycopg_pool import ConnectionPool

from service.errors import JobTableError
from service.jobs.engine import PATIENCE_S, SCHEMA as ENGINE_SCHEMA, Engine, in_words
from service.jobs.statements import OVERDUE, SCHEMA, SCHEMA_VERSION, Database
from service.jobs.table import WATCHED, JobTable
from service.process.loops import StopSignal
from service.settings import Settings

NUMBER = "BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY"
# The database's clock, because clocks of several machines differ.
EPOCH = """
CREATE FUNCTION epoch() RETURNS DOUBLE PRECISION LANGUAGE sql VOLATILE
AS 'SELECT extract(epoch FROM clock_timestamp())::DOUBLE PRECISION';
"""
# Our tables and the engine's have their own schemas. A worker that is stopped within a transaction must not keep its
# locks. PgBouncer refuses these as startup parameters.
SESSION = b"""
SET search_path = sgmethod, sgmethod_engine;
SET synchronous_commit = on;
SET idle_in_transaction_session_timeout = '10s';
"""
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


class PostgresJobTable(JobTable):
    """A job table in a PostgreSQL database, which is set up when first used.

    url: postgresql://user:password@host/database, or another form that libpq understands.
    """

    def __init__(self, url: str, settings: Settings) -> None:
        super().__init__(settings)
        try:
            conninfo = make_conninfo(url, **CONNECT)
        except psycopg.Error:  # its message may contain the password
            raise JobTableError("SG_DATABASE_URL cannot be read; its password must be percent-encoded") from None
        try:
            with _translated_errors():
                self._set_up(conninfo)
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
    def _set_up(conninfo: str) -> None:
        """Create the tables if there are none. This does not use the pool, so a wrong address is reported at once."""
        session_id = "SELECT pg_backend_pid()"
        with psycopg.connect(conninfo, autocommit=True) as other, psycopg.connect(conninfo, row_factory=dict_row) as db:
            before = other.execute(session_id).fetchone()
            # This begins a transaction, which a pooler in transaction mode runs in the session that `other` just left.
            db.execute(SESSION)
            if other.execute(session_id).fetchone() != before:
                raise JobTableError("the pooler is in transaction mode; let it pool sessions, or connect directly")
            db.execute("SELECT pg_advisory_xact_lock(%s)", (SET_UP_LOCK,))
            db.execute("CREATE SCHEMA IF NOT EXISTS sgmethod")
            db.execute("CREATE TABLE IF NOT EXISTS version (part TEXT PRIMARY KEY, version TEXT NOT NULL)")
            versions = {row["part"]: row["version"] for row in db.execute("SELECT * FROM version").fetchall()}
            written = int(versions.get("jobs", 0))
            if written not in (0, SCHEMA_VERSION):
                raise JobTableError("the database was written by another version of this service, which can read it")
            if written == 0:
                db.execute(f"{EPOCH} {SCHEMA.format(number=NUMBER)}".encode())
            if versions.get("engine") != procrastinate.__version__:
                # Tokens are recreated from the table, so an upgrade of the engine starts with empty tables.
                db.execute("DROP SCHEMA IF EXISTS sgmethod_engine CASCADE")
                db.execute("CREATE SCHEMA sgmethod_engine")
                db.execute("SET LOCAL search_path = sgmethod_engine")
                db.execute(ENGINE_SCHEMA.encode())
                db.execute("SET LOCAL search_path = sgmethod, sgmethod_engine")
            for part, version in (("jobs", str(SCHEMA_VERSION)), ("engine", procrastinate.__version__)):
                db.execute(
                    "INSERT INTO version VALUES (%s, %s) ON CONFLICT (part) DO UPDATE SET version = excluded.version",
                    (part, version),
                )

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
