"""The service that benchmarks.chaos does its worst to."""

from __future__ import annotations

import contextlib
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import httpx

from benchmarks.machine import ROOT

PATIENCE_S = 60.0
SETTINGS = {"workers": 3, "threads": 1, "lease_s": 2, "queue_length": 20, "stop_grace_s": 10, "port": 0}
KINDS = {"web": "-m service web", "worker": "-m service worker", "encoder": "service.encode_child"}


def _processes() -> dict[int, tuple[int, str]]:
    """Parent and command line of each process that is alive."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            with contextlib.suppress(OSError):
                state, parent = (entry / "stat").read_text().rpartition(")")[2].split()[:2]
                if state != "Z":
                    command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                    found[int(entry.name)] = (int(parent), command)
    return found


class ChaosService:
    """`python -m service serve` in a folder of its own."""

    def __init__(self, folder: Path, database_url: str) -> None:
        self._data = folder / "data"
        self._log = folder / "log"
        settings = {**SETTINGS, "data_dir": self._data, "database_url": database_url}
        self._environment = {**os.environ, **{f"SG_{k}".upper(): str(v) for k, v in settings.items()}}
        self._seen: set[int] = set()
        self.start()

    def start(self) -> None:
        """Start it, anew if it was there before."""
        with self._log.open("a") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "service", "serve"],
                cwd=ROOT,
                env=self._environment,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )
        assert self._process.stdout is not None
        with self._process.stdout as output:
            words = output.readline().split()
        assert words[:3] == ["sgmethod", "service", "on"], self._log.read_text()
        self._url = words[3].rstrip(",")

    def ask(self, method: str, path: str, **more: Any) -> httpx.Response | None:
        """The answer, or None if there was none."""
        try:
            return httpx.request(method, self._url + path, timeout=PATIENCE_S, **more)
        except httpx.TransportError:
            return None

    def jobs(self) -> dict[str, Any] | None:
        """All jobs by id; None if the service cannot say."""
        jobs: dict[str, Any] = {}
        path: str | None = "/jobs?limit=200"
        while path is not None:
            answer = self.ask("GET", path)
            if answer is None or answer.status_code != 200:
                return None
            page = answer.json()
            jobs |= {job["id"]: job for job in page["jobs"]}
            path = page["next"]
        return jobs

    def _ours(self, kind: str) -> list[int]:
        """Our processes of a kind."""
        processes = _processes()
        ours = {self._process.pid}
        for _ in range(2):  # children, then theirs
            ours |= {number for number, (parent, _command) in processes.items() if parent in ours}
        self._seen |= ours
        return sorted(number for number in ours if number in processes and KINDS[kind] in processes[number][1])

    def kill_one(self, kind: str, chance: random.Random) -> bool:
        """Kill one of a kind, if there is one."""
        victims = self._ours(kind)
        return bool(victims) and self._send(chance.choice(victims), signal.SIGKILL)

    def stop_worker(self, chance: random.Random) -> int | None:
        """Stop a worker as if its machine had frozen; its number."""
        workers = self._ours("worker")
        victim = chance.choice(workers) if workers else None
        return victim if victim and self._send(victim, signal.SIGSTOP) else None

    def continue_worker(self, number: int) -> None:
        """Undo stop_worker; the worker may be gone."""
        if number in self._ours("worker"):
            self._send(number, signal.SIGCONT)

    @staticmethod
    def _send(number: int, what: signal.Signals) -> bool:
        with contextlib.suppress(ProcessLookupError):
            os.kill(number, what)
            return True
        return False

    def kill_all(self) -> None:
        """Every process at once."""
        victims = [self._process.pid, *self._ours("worker"), *self._ours("web"), *self._ours("encoder")]
        for number in victims:
            self._send(number, signal.SIGKILL)
        self._process.wait(PATIENCE_S)

    def stop(self) -> int:
        """As an operator does; the exit status."""
        self._ours("worker")
        self._process.terminate()
        return self._process.wait(PATIENCE_S)

    def sweep(self) -> int:
        """Remove what no job needs, the service being stopped; how many files."""
        command = [sys.executable, "-m", "service", "sweep", "--orphan-age-s", "0"]
        done = subprocess.run(command, cwd=ROOT, env=self._environment, capture_output=True, text=True, check=True)
        match = re.search(r"files that no job needs: (\d+)", done.stdout)
        assert match is not None, done.stdout
        return int(match.group(1))

    def files(self) -> set[str]:
        """What lies in the storage."""
        folders = ("sources", "bitstreams", "unfinished")
        return {f"{folder}/{path.name}" for folder in folders for path in (self._data / folder).iterdir()}

    def published_twice(self) -> set[str]:
        """Jobs that two workers say they published."""
        said = Counter(re.findall(r"job ([0-9a-f]{32}): done, ", self._log.read_text()))
        return {job_id for job_id, times in said.items() if times > 1}

    def processes_left(self) -> set[int]:
        """Processes of ours that are still there a moment after the service has ended."""
        deadline = time.monotonic() + PATIENCE_S
        while left := self._seen & {number for number, (_, line) in _processes().items() if "service" in line}:
            if time.monotonic() > deadline:
                break
            time.sleep(0.1)
        return left
