"""A real service in processes of its own, for tests and benchmarks to ask, watch, stop and kill."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import httpx

from tests.harness.data import ROOT

T = TypeVar("T")
Kind = Literal["web", "worker", "encoder"]

PATIENCE_S = 120.0  # far more than anything takes, on a busy machine too
POLL_S = 0.05  # seldom enough to take little of a core
COMMANDS: dict[Kind, str] = {
    "web": "-m service web",
    "worker": "-m service worker",
    "encoder": "-m service.worker.encode_child",
}


def wait_until(what: Callable[[], T], patience_s: float = PATIENCE_S) -> T:
    """The first true value of what(); raises AssertionError if there is none in time."""
    deadline = time.monotonic() + patience_s
    while time.monotonic() < deadline:
        value = what()
        if value:
            return value
        time.sleep(POLL_S)
    raise AssertionError("nothing happened in time")


@dataclass(frozen=True)
class Process:
    """A process that is alive: who started it, and its command line."""

    parent: int
    command: str


def processes() -> dict[int, Process]:
    """All processes by number."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            with contextlib.suppress(OSError):
                state, parent = (entry / "stat").read_text().rpartition(")")[2].split()[:2]
                if state != "Z":
                    command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                    found[int(entry.name)] = Process(int(parent), command)
    return found


def encoder_of(job_id: str) -> int | None:
    """The process that encodes a job, if there is one, whoever started it."""
    for number, process in processes().items():
        if COMMANDS["encoder"] in process.command and job_id in process.command:
            return number
    return None


class ServiceProcess:
    """One `python -m service`, started at once, and a client of it.

    Give settings by name, such as queue_length=2; extra: more environment variables. What it writes to standard error
    is appended to a log beside its data folder.
    """

    timeout_s = PATIENCE_S  # of the client's requests

    def __init__(
        self, data_dir: Path, command: str = "serve", extra: Mapping[str, str] | None = None, **settings: Any
    ) -> None:
        self.data_dir = data_dir
        self.log = data_dir.with_name(data_dir.name + ".log")
        chosen = {"port": 0, "data_dir": data_dir, **settings}
        self.environment = {**os.environ, **{f"SG_{k}".upper(): str(v) for k, v in chosen.items()}, **(extra or {})}
        self._command = [sys.executable, "-m", "service", command]
        self.start()

    def start(self) -> None:
        """Start it, again after a stop or kill. It listens when this returns."""
        with self.log.open("a") as log:
            self.process = subprocess.Popen(
                self._command, cwd=ROOT, env=self.environment, stdout=subprocess.PIPE, stderr=log, text=True
            )
        assert self.process.stdout is not None
        with self.process.stdout as output:
            words = output.readline().split()
        if words[:3] != ["sgmethod", "service", "on"]:
            self.process.kill()
            self.process.wait()
            raise AssertionError(self.log.read_text())
        self.url = words[3].rstrip(",")
        self.client = httpx.Client(base_url=self.url, timeout=self.timeout_s)

    def family(self) -> dict[int, str]:
        """All its processes that are alive, by number, with their command lines."""
        alive = processes()
        family = {self.process.pid}
        for _ in range(2):  # children, then theirs
            family |= {number for number, process in alive.items() if process.parent in family}
        return {number: alive[number].command for number in sorted(family & alive.keys())}

    def ours(self, kind: Kind) -> list[int]:
        """The numbers of its processes of a kind."""
        return [number for number, command in self.family().items() if COMMANDS[kind] in command]

    def stop(self) -> int:
        """Stop it as an operator does; the exit status."""
        self.client.close()
        self.process.terminate()
        return self.process.wait(PATIENCE_S)

    def kill_all(self) -> None:
        """End every process at once, without a chance to say anything."""
        self.client.close()
        victims = self.family()
        for number in victims:
            with contextlib.suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        self.process.wait(PATIENCE_S)
        wait_until(lambda: not victims.keys() & processes().keys())

    def files(self) -> list[str]:
        """What lies in the storage."""
        folders = ("sources", "bitstreams", "unfinished")
        return sorted(f"{f}/{path.name}" for f in folders for path in (self.data_dir / f).iterdir())
