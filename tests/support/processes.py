"""Processes of this machine: which there are, waiting for what they do, and calls that fail at first."""

from __future__ import annotations

import contextlib
import os
import random
import re
import signal
import socket
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

from tests.support.data import ROOT

T = TypeVar("T")
Kind = Literal["web", "worker", "sandbox", "encoder"]

TIMEOUT_S = 120.0  # far more than anything takes, on a busy machine too
NAME_LENGTH = 15  # of a process, as the system shows it
END = signal.SIGUSR1  # ends an encode of the fake codec: tests/support/child
POLL_S = 0.05  # seldom enough to take little of a core
# Of command lines; the sandbox's forks have the sandbox's. An encoder has its job's id for a name.
KINDS: dict[Kind, str] = {
    "web": r".* -m service web .*",
    "worker": r".* -m service worker .*",
    "sandbox": r".* -m service\.sandbox\.server .*",
    "encoder": rf"[0-9a-f]{{{NAME_LENGTH}}}",
}


def wait_until(what: Callable[[], T], timeout_s: float = TIMEOUT_S) -> T:
    """The first true value of what(); raises AssertionError if there is none in time."""
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        value = what()
        if value:
            return value
        time.sleep(POLL_S)
    raise AssertionError("nothing happened in time")


def free_port() -> int:
    """A port of this machine that nothing uses now. Below those that the system gives out: no test that runs beside
    this one is given it before it is used.
    """
    while True:
        port = random.randrange(20_000, 32_000)
        with contextlib.suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port


def failing(works: Callable[..., T], *errors: Exception) -> Callable[..., T]:
    """The function, which raises these errors first, one a call."""
    left = iter(errors)

    def call(*arguments: Any, **named: Any) -> T:
        for error in left:
            raise error
        return works(*arguments, **named)

    return call


@dataclass(frozen=True)
class Outcome:
    """How a command ended, and what it printed."""

    status: int
    stdout: str
    stderr: str


def run(*command: object, folder: Path = ROOT, given: str = "", **environment: object) -> Outcome:
    """Run a program to its end. given: its standard input; environment: variables beside those of this process."""
    words = [str(word) for word in command]
    known = os.environ | {name: str(value) for name, value in environment.items()}
    done = subprocess.run(
        words, cwd=folder, env=known, input=given, capture_output=True, text=True, timeout=600, check=False
    )
    return Outcome(done.returncode, done.stdout, done.stderr)


@dataclass(frozen=True)
class Process:
    """A process that is alive: whose child it is, its name and its command line."""

    parent: int
    name: str
    command: str

    def is_a(self, kind: Kind) -> bool:
        """Whether it is one of the service's processes of this kind."""
        return re.fullmatch(KINDS[kind], self.name if kind == "encoder" else self.command) is not None


def processes() -> dict[int, Process]:
    """All processes by number."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            with contextlib.suppress(OSError):
                # Names of others' programs and files are bytes, not always UTF-8.
                state, parent = (entry / "stat").read_bytes().rpartition(b")")[2].split()[:2]
                if state != b"Z":
                    command = os.fsdecode((entry / "cmdline").read_bytes().replace(b"\0", b" "))
                    name = os.fsdecode((entry / "comm").read_bytes().strip())
                    found[int(entry.name)] = Process(int(parent), name, command)
    return found


def encoder_of(job_id: str) -> int | None:
    for number, process in processes().items():
        if process.name == job_id[:NAME_LENGTH]:
            return number
    return None


def running_encoder(job_id: str) -> int:
    """Wait for the process that encodes a job; its number."""
    return wait_until(lambda: encoder_of(job_id)) or 0


def worker_of(log: Path, job_id: str) -> int | None:
    """The worker that made the first attempt at a job, as its log says."""
    found = re.search(rf"job {job_id}: attempt 1 of worker .*:(\d+)$", log.read_text(), re.MULTILINE)
    return int(found[1]) if found else None


def end_early(encoder: int) -> None:
    """Let an encoder of the fake codec (tests/support/child) end with what it has. What a test does to a running encode
    it does to one that ends no sooner: however long the test itself has to wait for a core, it is not too late.
    """

    def listens() -> bool:  # before it does the signal would be its end
        status = Path("/proc", str(encoder), "status").read_text()
        caught = re.search(r"^SigCgt:\t([0-9a-f]+)$", status, re.MULTILINE)
        return caught is not None and bool(int(caught[1], 16) >> (END - 1) & 1)

    wait_until(listens)
    os.kill(encoder, END)
