"""Threads and tasks outlive unexpected errors: they go on, and the failure is counted."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from service import logs, processes
from service.api import app
from service.keys import KeyRing
from service.processes import PeriodicThread, StopSignal, Supervised
from tests.support.processes import TIMEOUT_S, failing, wait_until


def test_rounds_go_on() -> None:
    """As those that sweep and report."""
    until, done = StopSignal(), threading.Event()
    thread = PeriodicThread("testing", failing(done.set, RuntimeError("unexpected")), 0.01, until)
    thread.start()
    try:
        wait_until(lambda: done.is_set() or not thread.is_alive())
    finally:
        until.request()
        thread.join(TIMEOUT_S)
    assert done.is_set()


def test_a_process_that_hangs_is_restarted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its container was called unhealthy, which restarts nothing. One that goes on waiting does not hang."""
    monkeypatch.setattr(processes, "LOOK_S", 0.05)
    process = Supervised("a test", [sys.executable, "-c", "import time\nwhile True:\n    time.sleep(0.01)"], ())
    try:
        first, until = process.process.pid, time.monotonic() + 2 * processes.LOOK_S * processes.MAX_STILL_LOOKS
        while time.monotonic() < until:
            process.keep_alive()
            time.sleep(0.01)
        assert process.process.pid == first
        os.kill(first, signal.SIGSTOP)
        wait_until(lambda: process.keep_alive() or process.process.pid != first)
    finally:
        process.process.kill()
        process.process.wait()


def test_a_line_of_the_log_is_one_line() -> None:
    """Whatever a compromised task says of itself; a traceback keeps its lines."""
    record = logging.LogRecord("worker", logging.WARNING, "", 0, "job: %s", ("a\nERROR worker: b\x1b[2Jé",), None)
    assert logs._Lines("%(message)s").format(record) == r"job: a\nERROR worker: b\x1b[2Jé"
    record.exc_info = (ValueError, ValueError("no"), None)
    assert logs._Lines("%(message)s").format(record).endswith("é\nValueError: no")


def test_a_file_of_keys_that_is_being_written_locks_no_client_out(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Its first lines look like a whole file."""
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(app, "KEYS_POLL_S", 0.0)
    both, first, third = {"1": "ann", "2": "bob"}, {"1": "ann"}, {"3": "cat"}
    reads = iter([both, ValueError("no key"), *[first] * 4, ValueError("key 2 is none"), first, both, *[third] * 5])
    held: list[bool] = []
    ring = KeyRing(both)

    def read_keys() -> dict[str, str]:
        held.append(ring._names == both)
        if isinstance(read := next(reads, third), ValueError):
            raise read
        return read

    async def follow() -> None:
        parts: Any = SimpleNamespace(settings=SimpleNamespace(api_keys_file=Path(), read_keys=read_keys), keys=ring)
        reloading = asyncio.create_task(app._reload_keys(parts))
        async with asyncio.timeout(TIMEOUT_S):
            while ring._names != third and not reloading.done():
                await asyncio.sleep(0.01)
        reloading.cancel()

    asyncio.run(follow())
    assert all(held[:14])
    assert caplog.text.count("reloaded the API keys") == 1


def test_what_comes_again_and_again_is_logged_once_a_minute(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A full disk filled the log, which lay on it."""
    now = 0.0
    monkeypatch.setattr(logs.time, "monotonic", lambda: now)
    monkeypatch.setattr(logs, "_last_logged", {})
    for now in (0.0, 1.0, 59.0, 60.0, 61.0):
        logs.log_seldom(logging.getLogger("disk"), "no space for %d", now)
        logs.log_seldom(logging.getLogger("disk"), "something else")
    assert [record.getMessage() for record in caplog.records if "space" in record.msg] == [
        "no space for 0",
        "no space for 60",
    ]
    assert len(caplog.records) == 4
