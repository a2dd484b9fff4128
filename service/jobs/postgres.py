"""The job table in PostgreSQL, for workers on several machines."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import psycopg
from psycopg.conninfo import make_conninfo
from psycopg.rows import DictRow, dict_row
from psycopg_pool import ConnectionPool

from service.errors import JobTableError
from service.jobs.migrations import NEWEST_VERSION, SCHEMA, migrate
from service.jobs.table import JobTable
from service.settings import Settings

NUMBER = "BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY"
# The database's clock, because clocks of several machines differ.
EPOCH = """
CREATE FUNCTION epoch() RETURNS DOUBLE PRECISION LANGUAGE sql VOLATILE
AS 'SELECT extract(epoch FROM clock_timestamp())::DOUBLE PRECISION';
"""
# By statement, not by row: COPY of many jobs would change the same row again and again in one transaction, whose time
# grows with the square. In the order of the keys, so that no two transactions wait for each other.
ADDED = "SELECT owner, state, 1 AS jobs, image_bytes + file_bytes AS bytes FROM added"
REMOVED = "SELECT owner, state, -1 AS jobs, -image_bytes - file_bytes AS bytes FROM removed"
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
        ("insert", "NEW TABLE AS added", ADDED),
        ("delete", "OLD TABLE AS removed", REMOVED),
        ("update", "NEW TABLE AS added OLD TABLE AS removed", f"{ADDED} UNION ALL {REMOVED}"),
    )
)
# Set in each session, since PgBouncer refuses them as startup parameters. A worker that is stopped within a transaction
# must not keep its locks.
SESSION = b"""
SET search_path = sgmethod;
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
TIMEOUT_S = 5.0  # for a database that restarts
SET_UP_LOCK, QUEUE_LOCK = 0x5367_0001, 0x5367_0002


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
    except psycopg.errors.ReadOnlySqlTransaction as error:
        raise JobTableError("PostgreSQL is read-only, as a standby is; let SG_DATABASE_URL name the primary") from error
    except psycopg.Error as error:
        raise JobTableError(f"PostgreSQL: {' '.join(str(error).split())}") from error


def _set_up(conninfo: str) -> None:
    """Bring the tables to today's version without the pool, so that a wrong address is reported at once."""
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
        row = db.execute("SELECT version FROM version WHERE part = 'jobs'").fetchone()
        found = None if row is None else int(row["version"])
        if found is not None and found < NEWEST_VERSION:
            # At once, or a service that is submitting a job and this would wait for each other.
            db.execute("LOCK TABLE jobs IN ACCESS EXCLUSIVE MODE")
        version = migrate(_Session(db), found, (f"{EPOCH} {SCHEMA.format(number=NUMBER)} {TRIGGERS}",))
        if version is not None:
            db.execute(
                "INSERT INTO version VALUES ('jobs', %s) ON CONFLICT (part) DO UPDATE SET version = excluded.version",
                (str(version),),
            )


class PostgresJobTable(JobTable):
    """A job table in a PostgreSQL database.

    url: postgresql://user:password@host/database, or another form that libpq understands. Missing tables are created.
    """

    poll_s = 0.25

    def __init__(self, url: str, settings: Settings) -> None:
        super().__init__(settings)
        try:
            conninfo = make_conninfo(url, **CONNECT)
        except psycopg.Error:  # its message may contain the password
            raise JobTableError("SG_DATABASE_URL cannot be read; its password must be percent-encoded") from None
        try:
            with _translated_errors():
                _set_up(conninfo)
        except JobTableError as error:
            variables = ["SG_DATABASE_URL", *sorted(name for name in os.environ if name.startswith("PG"))]
            raise JobTableError(f"{', '.join(variables)}: {error}") from error
        logging.getLogger("psycopg.pool").setLevel(logging.ERROR)  # it logs a warning for each try to reconnect
        # Each connection is checked when it is taken, since a restart of the database breaks it.
        self._pool = ConnectionPool(
            conninfo,
            # Statements that the server keeps prepared would fail once a newer service has added a column.
            kwargs={"autocommit": True, "row_factory": dict_row, "prepare_threshold": None},
            configure=_begin_session,
            min_size=1,
            max_size=CONNECTIONS,
            timeout=TIMEOUT_S,
            reconnect_timeout=TIMEOUT_S,  # else pauses between tries grow to minutes
            check=ConnectionPool.check_connection,
            open=True,
            connection_class=psycopg.Connection[DictRow],
        )

    @contextmanager
    def _connection(self) -> Iterator[_Session]:
        with _translated_errors(), self._pool.connection() as db:
            try:
                yield _Session(db)
            except psycopg.errors.ReadOnlySqlTransaction:
                self._pool.drain()  # new sessions may be on another server, after a failover
                raise

    @contextmanager
    def _transaction(self, *, alone: bool = False) -> Iterator[_Session]:
        with self._connection() as db, db.connection.transaction():
            if alone:
                db.execute("SELECT pg_advisory_xact_lock(?)", (QUEUE_LOCK,))
            yield db

    def close(self) -> None:
        self._pool.close()
