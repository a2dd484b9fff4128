"""Kill, stop, restart and cancel at random while a real service works, then count its jobs and files.

    python -m benchmarks.service chaos [--jobs 200] [--seed 1] [--database-url sqlite | postgresql | postgresql://...]

Prints a ledger, and exits with 1 unless it balances: every accepted job is done, failed or cancelled; each result was
published once and can be fetched; after a sweep nothing else is left. With the bare word "postgresql" it starts a
server of its own, and restarts that now and then too. Pictures are tiny: most time goes to processes that start.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

from benchmarks.machine import RUNS, command, one_a_line, origin, write_text
from benchmarks.service.killed import ChaosService
from benchmarks.service.uploads import made_picture
from tests.support.postgres_server import HINT, PostgresServer, find_binaries

PAUSE_S = 0.6  # between two events, on average: a job waits some two seconds for its end
STUCK_AFTER_S = 180.0  # without any job that ends
WEIGHTS = {
    "encoder killed": 4,
    "worker killed": 3,
    "web process killed": 3,
    "worker stopped for a while": 4,
    "job cancelled": 4,
    "everything killed": 1,
    "service restarted": 1,
    "database restarted": 1,
}


class Submitter(threading.Thread):
    """Submit jobs, each under a key of its own, repeating each request until the answer is 202.

    error: an answer that no job should get, after which nothing more was submitted.
    """

    def __init__(self, service: ChaosService, jobs: int, seed: int) -> None:
        super().__init__(name="submitter", daemon=True)
        self._service, self._jobs, self._random = service, jobs, random.Random(seed + 1)
        self.accepted: list[str] = []
        self.asked_again = 0
        self.error = ""

    def run(self) -> None:
        for number in range(self._jobs):
            form = {"bpp": "1", "time_limit_s": str(self._random.choice([0.1, 0.3, 1.0]))}
            form["priority"] = self._random.choice(["interactive", "bulk"])
            image = made_picture(48, 32, number)
            if self._random.random() < 0.05:
                image = image[: len(image) // 2]  # its header is whole: the codec refuses
            more = {"files": {"image": image}, "data": form, "headers": {"Idempotency-Key": f"job-{number}"}}
            while (answer := self._service.ask("POST", "/encode", **more)) is None or answer.status_code != 202:
                if answer is not None and answer.status_code not in (429, 503):
                    self.error = f"POST /encode: {answer.status_code} {answer.text}"
                    return
                self.asked_again += 1
                time.sleep(0.5)
            self.accepted.append(str(answer.json()["id"]))
            time.sleep(self._random.uniform(0, 0.5))


class Chaos:
    """Random events, and what was seen of the jobs meanwhile."""

    def __init__(self, service: ChaosService, submitter: Submitter, postgres: PostgresServer | None, seed: int) -> None:
        self._service, self._submitter, self._postgres = service, submitter, postgres
        self._random = random.Random(seed)
        self._asleep: list[tuple[float, int]] = []
        self.happened: Counter[str] = Counter()
        self.cancelled: set[str] = set()
        self.results: dict[str, Any] = {}
        self.changed: set[str] = set()

    def rage(self) -> None:
        """Let events happen at random until all jobs are submitted."""
        weights = {name: weight for name, weight in WEIGHTS.items() if self._postgres or name != "database restarted"}
        while self._submitter.is_alive():
            (event,) = self._random.choices([*weights], [*weights.values()])
            if self._do(event):
                self.happened[event] += 1
                print(f"{len(self._submitter.accepted):4} accepted  {event}", file=sys.stderr, flush=True)
            time.sleep(self._random.expovariate(1 / PAUSE_S))
            self._wake(time.monotonic())
            self.look()
        self._wake(float("inf"))

    def _do(self, event: str) -> bool:
        """Let an event happen; return whether it could."""
        match event:
            case "encoder killed":
                return self._service.kill_one("encoder", self._random)
            case "worker killed":
                return self._service.kill_one("worker", self._random)
            case "web process killed":
                return self._service.kill_one("web", self._random)
            case "worker stopped for a while":
                if sleeper := self._service.stop_worker(self._random):
                    self._asleep.append((time.monotonic() + self._random.uniform(0.5, 6), sleeper))
                return bool(sleeper)
            case "job cancelled":
                return self._cancel()
            case "everything killed":
                self._service.kill_all()
                self._service.start()
            case "service restarted":
                self._wake(float("inf"))
                assert self._service.stop() == 0
                self._service.start()
            case "database restarted":
                assert self._postgres is not None
                self._postgres.stop("immediate")
                time.sleep(self._random.uniform(0, 2))
                self._postgres.start()
        return True

    def _wake(self, now: float) -> None:
        for at, sleeper in self._asleep:
            if at <= now:
                self._service.continue_worker(sleeper)
        self._asleep = [(at, sleeper) for at, sleeper in self._asleep if at > now]

    def _cancel(self) -> bool:
        jobs = [job_id for job_id in self._submitter.accepted[-30:] if job_id not in self.cancelled]
        if not jobs:
            return False
        job_id = self._random.choice(jobs)
        while (answer := self._service.ask("DELETE", f"/jobs/{job_id}")) is None or answer.status_code == 503:
            time.sleep(0.5)
        assert answer.status_code in (204, 404), answer.text  # 404: the answer to the first try was lost
        self.cancelled.add(job_id)
        return True

    def look(self) -> dict[str, Any] | None:
        """All jobs by id, None if the service does not answer. Records results that changed once published."""
        jobs = self._service.jobs()
        for job_id, job in (jobs or {}).items():
            if job["state"] == "done":
                result = (job["attempt"], job["finished_at"], job["result"])
                if self.results.setdefault(job_id, result) != result:
                    self.changed.add(job_id)
        return jobs

    def settle(self) -> dict[str, Any]:
        """Wait until no job is queued or running, or none has finished for long; return all jobs by id."""
        finished, since = -1, time.monotonic()
        while time.monotonic() - since < STUCK_AFTER_S:
            if (jobs := self.look()) is None:
                continue
            states = Counter(job["state"] for job in jobs.values())
            if not states["queued"] and not states["running"]:
                return jobs
            if states["done"] + states["failed"] != finished:
                finished, since = states["done"] + states["failed"], time.monotonic()
            time.sleep(0.5)
        return self.look() or {}


def can_be_fetched(service: ChaosService, job_id: str, job: dict[str, Any]) -> bool:
    """Whether the service returns the bitstream of a job that is done."""
    answer = service.ask("GET", f"/bitstreams/{job_id}.sg")
    return answer is not None and answer.status_code == 200 and len(answer.content) == job["result"]["bytes"]


def ledger(service: ChaosService, submitter: Submitter, chaos: Chaos) -> tuple[dict[str, int], bool]:
    """The lines of the ledger, and whether it balances. Stops the service."""
    jobs = chaos.settle()
    done, failed = ({i for i, job in jobs.items() if job["state"] == state} for state in ("done", "failed"))
    unfetched = [job_id for job_id in done if not can_be_fetched(service, job_id, jobs[job_id])]
    assert service.stop() == 0
    accepted = set(submitter.accepted)
    free = {"accepted": len(accepted), "done": len(done), "failed": len(failed), "cancelled": len(chaos.cancelled)}
    free["files that kills left behind, removed by the sweep"] = service.sweep()
    published, files = {f"bitstreams/{job_id}.{jobs[job_id]['attempt']}.sg" for job_id in done}, set(service.files())
    zero = {
        "lost": len(accepted - done - failed - chaos.cancelled - set(jobs)),
        "stuck": len(set(jobs) - done - failed),
        "never accepted, yet there": len(set(jobs) - accepted) + len(set(jobs) & chaos.cancelled),
        "done, but not to be fetched": len(unfetched),
        "published twice": len(chaos.changed | service.published_twice()),
        "files left over after that": len(files - published),
        "files missing": len(published - files),
        "processes left over": len(service.processes_left()),
    }
    balanced = free["accepted"] == free["done"] + free["failed"] + free["cancelled"] and not any(zero.values())
    why = Counter(f"failed because {jobs[job_id]['error']['code']}" for job_id in failed)
    return {**free, **zero, **why}, balanced


def main() -> int:
    """Exit status: 0 if the ledger balances."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--database-url", default="sqlite")
    parser.add_argument(
        "--out", type=Path, help="default: chaos-sqlite.json or chaos-postgresql.json of build/bench/service"
    )
    options = parser.parse_args()
    head = {"command": command("benchmarks.service chaos"), **origin()}
    postgres, url = None, options.database_url
    if url == "postgresql":
        if (binaries := find_binaries()) is None:
            raise SystemExit(HINT)
        postgres = PostgresServer(binaries)
        url = postgres.new_database()
    folder = Path(tempfile.mkdtemp(prefix="sg-chaos-"))
    began = time.monotonic()
    service = ChaosService(folder, url)
    try:
        submitter = Submitter(service, options.jobs, options.seed)
        chaos = Chaos(service, submitter, postgres, options.seed)
        submitter.start()
        chaos.rage()
        if submitter.error:
            raise SystemExit(submitter.error)
        lines, balanced = ledger(service, submitter, chaos)
    finally:
        service.kill_all()
        if postgres is not None:
            postgres.close()
    kind = "sqlite" if options.database_url == "sqlite" else "postgresql"
    row = {
        **{"database": kind, "balanced": balanced, "ledger": lines},
        **{"happened": dict(sorted(chaos.happened.items())), "asked_again": submitter.asked_again},
        **{"seconds": round(time.monotonic() - began)},
    }
    settings = {"jobs": options.jobs, "seed": options.seed, "pause_s": PAUSE_S, "weights": WEIGHTS}
    path = options.out or RUNS / "service" / f"chaos-{kind}.json"
    write_text(path, one_a_line({**head, "settings": settings, "rows": [row]}))
    print(json.dumps(row, indent=1))
    if balanced:
        shutil.rmtree(folder)
    else:
        print(f"data and log are kept in {folder}", file=sys.stderr)
    return 0 if balanced else 1
