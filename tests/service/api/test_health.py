"""Probes and figures."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import shutil
import signal
import sqlite3
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, cast

import httpx2
import pytest

from service.api.context import WORK_THREADS
from service.api.health import Parts, Probes
from service.api.metrics import VERSION
from tests.support.data import PICTURE
from tests.support.job_table import grow_older
from tests.support.pictures import SMALL
from tests.support.processes import TIMEOUT_S, wait_until
from tests.support.service import FAKE_CODEC, StartService, assert_problem

pytestmark = pytest.mark.thorough

STALL_S = 1000  # which no test waits for


def test_a_queue_without_workers_is_not_ready(start_service: StartService) -> None:
    web = start_service("web", lease_s=1)
    web.wait_ready()
    assert web.client.get("/readyz").status_code == web.client.head("/readyz").status_code == 200
    job_id = web.accepted()
    problem = wait_until(lambda: (answer := web.client.get("/readyz")).status_code == 503 and answer)
    assert isinstance(problem, httpx2.Response)
    assert_problem(problem, 503, "no worker")
    assert web.client.get("/livez").status_code == 200
    web.client.delete(f"/jobs/{job_id}")
    assert web.client.get("/readyz").status_code == 200
    web.accepted()
    web.published(PICTURE)  # a worker was there just now
    web.accepted()
    assert web.client.get("/readyz").status_code == 200


def test_a_long_encode_is_no_stall(start_service: StartService) -> None:
    """Its worker's heartbeats tell that it lives."""
    service = start_service(lease_s=STALL_S / 4, extra=FAKE_CODEC)
    service.wait(service.accepted_slow(), "running")
    service.accepted()
    started = service.figures()["process_start_time_seconds"]
    with service.table() as table:
        grow_older(table, 10 * STALL_S)
    wait_until(lambda: service.client.get("/readyz").status_code == 200)
    assert service.figures()["sgmethod_oldest_job_waits_seconds"] > STALL_S
    assert service.figures()["process_start_time_seconds"] == started


def test_a_storage_and_a_job_table_out_of_reach(start_service: StartService) -> None:
    web = start_service("web")
    shutil.move(web.data_dir / "sources", web.data_dir / "aside")
    assert_problem(web.client.get("/readyz"), 503, "storage")
    assert web.client.get("/livez").status_code == 200
    shutil.move(web.data_dir / "aside", web.data_dir / "sources")
    # In place, since a mapped file must not become shorter, and what is mapped last: while that is whole, or is made
    # again by a look of the service's own, SQLite answers from what it has read before.
    for end in ("", "-wal", "-shm"):
        with (web.data_dir / f"jobs.sqlite3{end}").open("r+b") as file:
            file.write(b"this is no database" * 1000)
    assert_problem(web.client.get("/readyz"), 503, "job table")
    assert web.client.get("/livez").status_code == 200
    assert web.figures()["sgmethod_job_table_up"] == 0


def test_a_sandbox_that_does_no_tasks(start_service: StartService) -> None:
    service = start_service(lease_s=STALL_S, extra=FAKE_CODEC)
    service.wait_ready()
    sandbox = service.sandbox()
    os.kill(sandbox, signal.SIGSTOP)
    wait_until(lambda: service.client.get("/readyz").status_code == 503)
    assert_problem(service.client.get("/readyz"), 503, "sandbox")
    assert service.client.get("/livez").status_code == 200
    os.kill(sandbox, signal.SIGCONT)
    service.wait_ready()


def test_nothing_waits_behind_requests_that_wait_for_a_lock(start_service: StartService) -> None:
    web = start_service("web")
    web.wait_ready()
    jobs = [web.accepted() for _ in range(WORK_THREADS + 10)]
    lock = sqlite3.connect(web.data_dir / "jobs.sqlite3", isolation_level=None)
    with contextlib.closing(lock), ThreadPoolExecutor(len(jobs)) as pool:
        lock.execute("BEGIN IMMEDIATE")
        deletions = [pool.submit(web.client.delete, f"/jobs/{job}") for job in jobs]
        threads = Path("/proc", str(web.process.pid), "task")
        wait_until(lambda: len(list(threads.iterdir())) > WORK_THREADS)  # all that there are for this
        for path in ("/livez", "/readyz", "/", "/static/main.js", "/jobs", f"/jobs/{jobs[-1]}", "/metrics"):
            assert httpx2.get(web.url + path, timeout=TIMEOUT_S).status_code == 200
            assert not any(deletion.done() for deletion in deletions)
        lock.execute("ROLLBACK")
        assert {deletion.result().status_code for deletion in deletions} == {204}


def test_workers_are_known_by_name(start_service: StartService) -> None:
    """Idle ones too, and one that was killed as long as its age is of interest."""
    service = start_service(workers=2, extra=FAKE_CODEC)

    def seen() -> dict[str, float]:
        figures = {name: age for name, age in service.figures().items() if "worker_seen_seconds" in name}
        return {re.findall(r'worker="[^"]*:(\d+)"', name)[0]: age for name, age in figures.items()}

    wait_until(lambda: len(seen()) == 2 and seen().keys() == {str(number) for number in service.ours("worker")})
    assert max(seen().values()) < 60
    victim = service.ours("worker")[0]
    os.kill(victim, signal.SIGKILL)
    wait_until(lambda: len(seen()) == 3)  # it, and who came in its place
    assert str(victim) in seen()
    stopped = service.ours("worker")[-1]
    os.kill(stopped, signal.SIGTERM)
    wait_until(lambda: str(stopped) not in seen())


def test_figures(start_service: StartService) -> None:
    web = start_service("web")
    done = web.published(PICTURE)
    web.accepted()
    for _ in range(3):
        assert web.client.get(f"/decode/{done}.png").status_code == 200
    web.client.get("/decode/nothing.png")
    web.client.get("/no/such/path")
    web.client.request("BREW", "/no/such/path")
    seen = web.figures()
    assert seen["sgmethod_waits"] == 0
    assert (seen['sgmethod_jobs{state="queued"}'], seen['sgmethod_jobs{state="done"}']) == (1, 1)
    route = "/decode/{job_id}.{kind}"
    assert seen[f'sgmethod_requests_total{{method="GET",route="{route}",status="200"}}'] == 3
    assert seen[f'sgmethod_requests_total{{method="GET",route="{route}",status="404"}}'] == 1
    assert seen['sgmethod_requests_total{method="GET",route="none",status="404"}'] == 1
    assert seen["sgmethod_decode_seconds_count"] == 1  # twice from memory
    outcomes = {name: seen[f"sgmethod_jobs_{name}_total"] for name in ("finished", "failed", "retried", "cancelled")}
    assert outcomes == {"finished": 1, "failed": 0, "retried": 0, "cancelled": 0}
    assert seen["sgmethod_encode_seconds_count"] == 1
    assert seen["sgmethod_queue_seconds_count"] == 1
    assert seen[f'sgmethod_build_info{{version="{VERSION}"}}'] == 1
    assert seen["sgmethod_job_table_up"] == 1
    assert seen['sgmethod_refusals_total{reason="unknown"}'] == 2
    assert not [name for name in seen if re.search(r"such|BREW", name)]


def test_waiting_for_a_job_is_no_slow_answer(start_service: StartService) -> None:
    """One client that waited for its files was the p99 of all requests."""
    web = start_service("web")
    began = time.monotonic()
    assert web.client.post("/encode?bpp=1&wait=4", content=SMALL).status_code == 202  # reading the header is part of it
    took_s = time.monotonic() - began
    assert web.figures()['sgmethod_request_seconds_sum{route="/encode"}'] < took_s - 2


def test_refusals_by_reason(start_service: StartService) -> None:
    web = start_service("web", queue_length=1)
    web.post(key="once")
    web.post(key="once")
    assert len(web.client.get("/jobs").json()["jobs"]) == 1
    for answer in (web.post(), web.post(b"", key="once"), web.post(bpp=-1)):
        assert answer.status_code in (422, 429)
    web.client.get("/livez?x=1")
    counted = {name: number for name, number in web.figures().items() if name.startswith("sgmethod_refusals_total")}
    reasons = {name: number for name, number in counted.items() if number}
    expected = {"queue": 2, "invalid": 2}
    assert reasons == {f'sgmethod_refusals_total{{reason="{reason}"}}': number for reason, number in expected.items()}


def test_one_look_answers_all_who_ask_meanwhile() -> None:
    """And a client that goes takes nobody's answer along."""
    looks: list[int] = []

    class Table:
        def check_writable(self) -> None:
            looks.append(len(looks))

        def counts(self) -> str:
            return "counts"

    class NoStorage:
        def check(self) -> None:
            raise OSError("it is gone")

    async def ask() -> None:
        probes = Probes(cast(Any, Table()), cast(Any, NoStorage()))
        leaving = asyncio.ensure_future(probes.parts())
        await asyncio.sleep(0)
        leaving.cancel()
        for number in (1, 2):
            parts = await asyncio.gather(*(probes.parts() for _ in range(9)))
            assert parts == [Parts(cast(Any, "counts"), None)] * 9
            assert len(looks) == number

    asyncio.run(ask())
