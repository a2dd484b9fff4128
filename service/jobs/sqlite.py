"""The job table in SQLite: one file, one machine, nothing to install."""

from __future__ import annotations

import queue
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

from service.errors import JobTableError
from service.jobs.migrations import SCHEMA, migrate
from service.jobs.table import JobTable
from service.settings import Settings

BUSY_TIMEOUT_S = 30.0
NUMBER = "INTEGER PRIMARY KEY AUTOINCREMENT"
ADD = """
INSERT INTO stored VALUES (NEW.owner, NEW.state, 1, NEW.image_bytes + NEW.file_bytes)
ON CONFLICT (owner, state) DO UPDATE SET jobs = jobs + 1, bytes = bytes + excluded.bytes
"""
REMOVE = """
UPDATE stored SET jobs = jobs - 1, bytes = bytes - OLD.image_bytes - OLD.file_bytes
WHERE owner = OLD.owner AND state = OLD.state
"""
COUNTED = "owner, state, image_bytes, file_bytes"
TRIGGERS = (
    f"CREATE TRIGGER jobs_come AFTER INSERT ON jobs BEGIN {ADD}; END",
    f"CREATE TRIGGER jobs_go AFTER DELETE ON jobs BEGIN {REMOVE}; END",
    f"CREATE TRIGGER jobs_change AFTER UPDATE OF {COUNTED} ON jobs BEGIN {REMOVE}; {ADD}; END",
)
LOG_BYTES = 4_000_000  # about where SQLite begins its log anew: after 1,000 pages
FILL_LOG = f"""
PRAGMA cache_size = 10; BEGIN IMMEDIATE; CREATE TABLE room (bytes); INSERT INTO room VALUES (zeroblob({LOG_BYTES}));
ROLLBACK
"""
SESSION = "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON;"


class SqliteJobTable(JobTable):
    """A job table in one SQLite file in WAL mode, every commit synced to disk. A missing file is created."""

    def __init__(self, path: Path, settings: Settings) -> None:
        super().__init__(settings)
        self._path = path
        self._file: tuple[int, int] | None = None  # device and inode of the file that the idle connections have open
        self._idle: queue.LifoQueue[sqlite3.Connection] = queue.LifoQueue()
        path.touch(mode=0o600)
        self._follow_file()

    def _set_up(self) -> None:
        create = (*SCHEMA.format(number=NUMBER).split(";")[:-1], *TRIGGERS)
        with self._transaction() as db:
            found = db.execute("PRAGMA user_version").fetchone()[0]
            try:
                version = migrate(db, found or None, create)
            except JobTableError as error:
                raise JobTableError(f"{self._path}: {error}") from error
            if version is not None:
                db.execute(f"PRAGMA user_version = {version}")

    def _follow_file(self) -> None:
        """Reopen a file that was replaced: writes to the old one would be lost with its last reader."""
        try:
            found = self._path.stat()
        except OSError as error:  # else SQLite would create an empty file
            raise JobTableError(f"{self._path}: {error.strerror}") from error
        file = (found.st_dev, found.st_ino)
        if file == self._file:
            return
        self.close()
        self._file, self._idle = file, queue.LifoQueue()
        try:
            self._set_up()
            self._make_room()
        except JobTableError:
            self.close()
            self._file = None  # so that the next call sets it up
            raise

    def _make_room(self) -> None:
        """Bring the log to its full size by a change that is undone: on a full disk, jobs can then still be removed."""
        with suppress(OSError, sqlite3.Error):  # as when there is no room already
            if Path(f"{self._path}-wal").stat().st_size < LOG_BYTES:
                with closing(self._connect()) as db:
                    db.executescript(FILL_LOG)

    def _connect(self, timeout_s: float = BUSY_TIMEOUT_S) -> sqlite3.Connection:
        # A connection serves one thread at a time, but not always the same one.
        db = sqlite3.connect(self._path, timeout=timeout_s, isolation_level=None, check_same_thread=False)
        db.row_factory = sqlite3.Row
        db.create_function("epoch", 0, time.time)
        return db

    @contextmanager
    def _connection(self) -> Iterator[sqlite3.Connection]:
        """Provide a connection. It is discarded after an SQLite error, so that the next try starts afresh."""
        self._follow_file()
        idle, db = self._idle, None
        try:
            try:
                db = idle.get_nowait()
            except queue.Empty:
                db = self._connect()
                _begin_session(db)
            yield db
        except sqlite3.Error as error:
            if db is not None:
                db.close()
            # SQLite reports a full disk as an I/O error if its shared memory does not fit.
            words = "disk is full" if "SHMSIZE" in getattr(error, "sqlite_errorname", "") else error
            raise JobTableError(f"{self._path}: {words}") from error
        except BaseException:
            if db is not None:
                idle.put(db)
            raise
        idle.put(db)

    @contextmanager
    def _transaction(self, *, alone: bool = False) -> Iterator[sqlite3.Connection]:
        """Provide a transaction that holds the write lock from the start: it is alone, and does not fail half-way."""
        with self._connection() as db:
            db.execute("BEGIN IMMEDIATE")
            with db:  # commits, or rolls back
                yield db

    def check_writable(self) -> None:
        self._follow_file()
        try:
            # A new connection: idle ones may predate a disk's change to read-only, where BEGIN IMMEDIATE succeeds.
            with closing(self._connect(0.0)) as db:
                db.execute("DELETE FROM workers WHERE 0")
        except sqlite3.Error as error:
            if not getattr(error, "sqlite_errorname", "").startswith("SQLITE_BUSY"):  # then somebody else is writing
                raise JobTableError(f"{self._path}: {error}") from error

    def close(self) -> None:
        while True:
            try:
                self._idle.get_nowait().close()
            except queue.Empty:
                return


def _begin_session(db: sqlite3.Connection) -> None:
    """Make the settings of SESSION. Where several processes change a new file to WAL, SQLite fails some at once."""
    until = time.monotonic() + BUSY_TIMEOUT_S
    while True:
        try:
            db.executescript(SESSION)
            return
        except sqlite3.OperationalError as error:
            if not error.sqlite_errorname.startswith("SQLITE_BUSY") or time.monotonic() > until:
                raise
            time.sleep(0.01)
