"""The service that chaos.py kills."""

from __future__ import annotations

import contextlib
import os
import random
import re
import signal
import time
from collections import Counter
from pathlib import Path
from typing import Any

import httpx2

from service.opening import open_job_table, open_storage
from service.settings import Settings
from service.worker.sweeping import sweep
from tests.support.processes import TIMEOUT_S, Kind, Process, processes
from tests.support.service import ServiceProcess

SETTINGS: dict[str, Any] = {
    **{"workers": 3, "lease_s": 2, "queue_length": 20},
    "source_retention_s": 0,  # what is left over shows at once
}


class ChaosService(ServiceProcess):
    """`python -m service serve` in a folder of its own."""

    def __init__(self, folder: Path, database_url: str) -> None:
        self._seen: set[int] = set()
        super().__init__(folder / "data", database_url=database_url, **SETTINGS)

    def ask(self, method: str, path: str, **more: Any) -> httpx2.Response | None:
        """The answer, or None if there was none."""
        try:
            return httpx2.request(method, self.url + path, timeout=TIMEOUT_S, **more)
        except httpx2.TransportError:
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

    def family(self) -> dict[int, Process]:
        family = super().family()
        self._seen |= family.keys()
        return family

    def kill_one(self, kind: Kind, chance: random.Random) -> bool:
        """Kill one of a kind, if there is one."""
        victims = self.ours(kind)
        return bool(victims) and self._send(chance.choice(victims), signal.SIGKILL)

    def stop_worker(self, chance: random.Random) -> int | None:
        """Stop a worker as if its machine had frozen; its number."""
        workers = self.ours("worker")
        victim = chance.choice(workers) if workers else None
        return victim if victim and self._send(victim, signal.SIGSTOP) else None

    def continue_worker(self, number: int) -> None:
        """Undo stop_worker; the worker may be gone."""
        if number in self.ours("worker"):
            self._send(number, signal.SIGCONT)

    @staticmethod
    def _send(number: int, what: signal.Signals) -> bool:
        with contextlib.suppress(ProcessLookupError):
            os.kill(number, what)
            return True
        return False

    def stop(self) -> int:
        self.family()  # to be seen once more
        return super().stop()

    def sweep(self) -> int:
        """Remove what no job needs, the service being stopped; how many files."""
        settings = Settings(data_dir=self.data_dir, database_url=self.environment["SG_DATABASE_URL"])
        with contextlib.closing(open_job_table(settings)) as table:
            return sweep(table, open_storage(settings), retention_s=0, orphan_age_s=0).files

    def published_twice(self) -> set[str]:
        """Jobs that were published twice, by the log."""
        published = Counter(re.findall(r"job ([0-9a-f]{32}): done, ", self.log.read_text()))
        return {job_id for job_id, times in published.items() if times > 1}

    def processes_left(self) -> set[int]:
        """Processes of ours that are still there a moment after the service has ended."""
        deadline = time.monotonic() + TIMEOUT_S
        while left := self._seen & {number for number, process in processes().items() if "service" in process.command}:
            if time.monotonic() > deadline:
                break
            time.sleep(0.1)
        return left
