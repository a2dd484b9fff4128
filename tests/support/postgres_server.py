"""A real PostgreSQL server for tests and benchmarks, started in a folder of its own, on a Unix socket."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psycopg

from tests.support.processes import wait_until

HINT = "PostgreSQL is not installed, so nothing was tested on it: sudo apt install postgresql"
REQUIRED = "SGMETHOD_TEST_POSTGRES"  # set to "required", a missing PostgreSQL fails the tests
# What a crash of the whole machine would cost is not tested, and syncing takes time.
QUICK = "-c fsync=off -c max_connections=200 -c shared_buffers=32MB -c autovacuum=off"


def find_binaries() -> Path | None:
    """The folder of PostgreSQL's programs, the latest version's; None if there are none."""
    on_path = shutil.which("initdb")
    folders = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda path: float(path.parent.name))
    candidates = [Path(on_path).resolve().parent] if on_path else folders[::-1]
    return next((folder for folder in candidates if (folder / "initdb").exists()), None)


def _unprivileged() -> dict[str, Any]:
    """PostgreSQL refuses to run as root, so root lends it another user."""
    if os.geteuid() != 0:
        return {}
    known = {entry.pw_name: entry for entry in pwd.getpwall()}
    entry = known.get("postgres") or known["nobody"]
    return {"user": entry.pw_uid, "group": entry.pw_gid, "extra_groups": []}


class PostgresServer:
    """One server with as many databases as are asked for."""

    def __init__(self, binaries: Path) -> None:
        self._binaries = binaries
        self._as = _unprivileged()
        # Not in pytest's folder, which no other user can enter; and a socket's path must be short.
        self.folder = Path(tempfile.mkdtemp(prefix="sg-postgres-"))
        self._databases = 0
        if self._as:
            os.chown(self.folder, self._as["user"], self._as["group"])
        self._run("initdb", "--auth=trust", "--username=postgres", "--encoding=UTF8", "--no-sync", self._data)
        self.start()

    @property
    def _data(self) -> str:
        return str(self.folder / "data")

    def _run(self, program: str, *arguments: str) -> None:
        command = [str(self._binaries / program), *arguments]
        log = self.folder / "commands.log"  # not a pipe, which the server would keep open
        with log.open("w") as output:
            result = subprocess.run(command, cwd="/", stdout=output, stderr=output, check=False, **self._as)
        assert result.returncode == 0, log.read_text()

    def start(self) -> None:
        """Start the server; it answers when this returns."""
        options = f"{QUICK} -c listen_addresses= -c unix_socket_directories={self.folder}"
        self._run("pg_ctl", "start", "--wait", "-D", self._data, "-l", f"{self._data}/server.log", "-o", options)

    def stop(self, mode: str = "fast") -> None:
        """Stop it; mode "immediate" is as a crash."""
        self._run("pg_ctl", "stop", "--wait", "-D", self._data, "-m", mode)

    def url(self, database: str) -> str:
        """How to reach a database."""
        return f"postgresql://postgres@/{database}?host={self.folder}"

    def new_database(self, options: str = "") -> str:
        """The address of a new, empty database. options: of CREATE DATABASE."""
        self._databases += 1
        name = f"test{self._databases}"
        with psycopg.connect(self.url("postgres"), autocommit=True) as db:
            db.execute(f"CREATE DATABASE {name} {options}".encode())
        return self.url(name)

    @contextmanager
    def pooled(self, pgbouncer: str, mode: str) -> Iterator[str]:
        """The address of a new database behind PgBouncer, which pools a "session" or a "transaction"."""
        database = self.new_database().partition("?")[0]
        port = 6543
        socket = self.folder / f".s.PGSQL.{port}"
        lines = ["[databases]", f"* = host={self.folder} user=postgres", "[pgbouncer]", "auth_type = any"]
        lines += [f"unix_socket_dir = {self.folder}", f"listen_port = {port}", f"pool_mode = {mode}"]
        settings = self.folder / "pgbouncer.ini"
        settings.write_text("\n".join(lines))
        with subprocess.Popen([pgbouncer, "--quiet", settings], stderr=subprocess.DEVNULL, **self._as) as pooler:
            try:
                wait_until(socket.exists)
                yield f"{database}?host={self.folder}&port={port}"
            finally:
                pooler.terminate()
        socket.unlink(missing_ok=True)

    def close(self) -> None:
        """Stop it and remove everything."""
        self.stop("immediate")
        shutil.rmtree(self.folder)
