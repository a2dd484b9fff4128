"""Threads and tasks outlive what nobody foresaw: they go on, and the failure is counted."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable, Iterator
from itertools import chain, repeat
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from service import logs
from service.api import app
from service.jobs import engine
from service.jobs.table import JobTable
from service.keys import KeyRing, digest
from service.process.loops import Rounds, StopSignal, failures
from service.storage.files import DiskStorage
from service.worker.notifying import send_next
from service.worker.sweeping import sweep
from tests.harness.job_table import LONG_S, open_table
from tests.harness.postgres_server import PostgresServer
from tests.harness.processes import PATIENCE_S, wait_until

Made = Callable[[JobTable, Path, StopSignal], threading.Thread]


def sweeper(table: JobTable, folder: Path, until: StopSignal) -> threading.Thread:
    def do() -> None:
        sweep(table, DiskStorage(folder), retention_s=0.1)

    return Rounds("sweeping", do, 0.01, until)


def signs(table: JobTable, _folder: Path, until: StopSignal) -> threading.Thread:
    return Rounds("signing", lambda: table.sign("worker"), 0.01, until)


def notifier(table: JobTable, _folder: Path, until: StopSignal) -> threading.Thread:
    return Rounds("notifying", lambda: send_next(table, "http://127.0.0.1:1/", b"key"), 0.01, until)


def refilling(table: JobTable, _folder: Path, until: StopSignal) -> threading.Thread:
    return threading.Thread(target=table.deliver, args=(lambda: False, until))


@pytest.mark.parametrize(
    ("made", "method"), [(sweeper, "needed_keys"), (signs, "sign"), (notifier, "due_notice"), (refilling, "_top_up")]
)
def test_threads_go_on(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made: Made, method: str
) -> None:
    monkeypatch.setattr(engine, "TOP_UP_S", 0.01)
    database = "sqlite"
    if made is refilling:
        server: PostgresServer = request.getfixturevalue("postgres")
        database = server.new_database()
    table, until, calls = open_table(database, tmp_path, LONG_S), StopSignal(), []
    works = getattr(table, method)

    def fails_once(*arguments: Any) -> Any:
        calls.append(arguments)
        if len(calls) == 1:
            raise RuntimeError("nobody foresaw this")
        return works(*arguments)

    monkeypatch.setattr(table, method, fails_once)
    before, thread = failures.total(), made(table, tmp_path, until)
    thread.start()
    try:
        wait_until(lambda: len(calls) > 1 or not thread.is_alive())
    finally:
        until.request()
        thread.join(PATIENCE_S)
        table.close()
    assert len(calls) > 1
    assert failures.total() == before + 1


def test_keys_are_read_until_they_can_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever failed before."""
    wrong = [RuntimeError("nobody foresaw this"), ValueError("cannot be read")]
    answers: Iterator[Any] = chain(wrong, repeat({digest("a key"): "ann"}))

    def read_keys() -> dict[str, str]:
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(app, "KEYS_POLL_S", 0.0)
    ring = KeyRing({})
    parts: Any = SimpleNamespace(settings=SimpleNamespace(api_keys_file=tmp_path, read_keys=read_keys), keys=ring)

    async def follow() -> None:
        reloading = asyncio.create_task(app._reload_keys(parts))
        async with asyncio.timeout(PATIENCE_S):
            while not ring and not reloading.done():
                await asyncio.sleep(0.01)
        reloading.cancel()

    asyncio.run(follow())
    assert ring.owner_of("a key") == "ann"


def test_what_comes_again_and_again_is_logged_once_a_minute(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A full disk filled the log, which lay on it."""
    now = 0.0
    monkeypatch.setattr(logs.time, "monotonic", lambda: now)
    monkeypatch.setattr(logs, "_said", {})
    for now in (0.0, 1.0, 59.0, 60.0, 61.0):
        logs.log_seldom(logging.getLogger("disk"), "no room for %d", now)
        logs.log_seldom(logging.getLogger("disk"), "something else")
    assert [record.getMessage() for record in caplog.records if "room" in record.msg] == [
        "no room for 0",
        "no room for 60",
    ]
    assert len(caplog.records) == 4
