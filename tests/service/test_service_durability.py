"""No accepted job is lost, stuck, run by two or left lying, whichever process dies when."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import partial

import pytest
from service_process import (
    ROOT,
    SLOW,
    Service,
    StartService,
    encoder_of,
    parent_of,
    processes,
    wait_until,
)


@pytest.fixture
def start_service(start_service: StartService, database_url: str) -> StartService:
    """Every test here runs once on either database."""
    return partial(start_service, database_url=database_url)


def running(job_id: str) -> int:
    """Wait for the job's encoder; its process number."""
    return wait_until(lambda: encoder_of(job_id)) or 0


def assert_only_results_remain(service: Service, *job_ids: str) -> None:
    results = wait_until(lambda: [name for name in service.files() if name.startswith("bitstreams/")])
    assert service.files() == results  # no source, nothing unfinished
    assert {name.split("/")[1].split(".")[0] for name in results} == set(job_ids)
    assert len(results) == len(job_ids)


def test_killed_encoder(start_service: StartService) -> None:
    """The encoding process alone dies: its worker starts it again at once."""
    service = start_service()
    job_id = service.accepted()
    os.kill(running(job_id), signal.SIGKILL)
    job = service.wait(job_id)
    assert (job["state"], job["attempt"], job["error"]) == ("done", 2, None)
    assert_only_results_remain(service, job_id)


def test_killed_worker(start_service: StartService) -> None:
    """The worker dies: its encoder goes too, and the job goes to the next worker when the lease is over."""
    service = start_service()
    job_id = service.accepted()
    encoder = running(job_id)
    (worker,) = service.children("worker")
    os.kill(worker, signal.SIGKILL)
    wait_until(lambda: encoder not in processes())
    job = service.wait(job_id)
    assert (job["state"], job["attempt"]) == ("done", 2)
    assert service.children("worker") != [worker]
    assert_only_results_remain(service, job_id)


def test_killed_web_process(start_service: StartService) -> None:
    """The web process dies right after its 202: the encode goes on, and requests find its successor."""
    service = start_service()
    job_id = service.accepted()
    (web,) = service.children("web")
    os.kill(web, signal.SIGKILL)
    service.client.close()
    service.client = type(service.client)(base_url=service.url, timeout=60)
    job = service.wait(job_id)
    assert (job["state"], job["attempt"]) == ("done", 1)
    assert service.children("web") != [web]


def test_everything_killed(start_service: StartService) -> None:
    """All processes die, one job being encoded and one waiting: both are done after the next start."""
    service = start_service()
    jobs = [service.accepted() for _ in range(2)]
    running(jobs[0])
    service.kill_all()
    service.start()
    assert [service.wait(job_id)["state"] for job_id in jobs] == ["done", "done"]
    assert [service.job(job_id)["attempt"] for job_id in jobs] == [2, 1]
    assert_only_results_remain(service, *jobs)
    picture = service.client.get(f"/decode/{jobs[0]}.png")
    assert picture.status_code == 200
    assert service.stop() == 0
    service.start()
    assert service.client.get(f"/decode/{jobs[0]}.png").content == picture.content


def test_stopping_hands_the_job_back(start_service: StartService) -> None:
    """SIGTERM: exit status 0, no process left, and the job waits unharmed at its place."""
    service = start_service(max_attempts=1)
    job_id = service.accepted_slow()
    encoder = running(job_id)
    ours = {service.process.pid, encoder, *service.children("web"), *service.children("worker")}
    assert service.stop() == 0
    assert not ours & set(processes())
    service.start()
    assert service.wait(job_id, "running", "failed")["state"] == "running"
    assert service.job(job_id)["attempt"] == 2
    assert service.client.delete(f"/jobs/{job_id}").status_code == 204


def test_interrupt_stops_too(start_service: StartService) -> None:
    service = start_service()
    service.client.close()
    service.process.send_signal(signal.SIGINT)
    assert service.process.wait(30) == 0


def test_a_worker_by_itself(start_service: StartService) -> None:
    """A worker started by hand takes jobs from the same folder, and stops with exit status 0."""
    web = start_service("web")
    command = [sys.executable, "-m", "service", "worker"]
    with web.log.open("a") as log:
        worker = subprocess.Popen(command, cwd=ROOT, env=web.environment, stderr=log)
    job_id = web.accepted()
    assert web.wait(job_id)["state"] == "done"
    worker.send_signal(signal.SIGTERM)
    assert worker.wait(30) == 0
    assert_only_results_remain(web, job_id)


def test_supervisor_killed_alone(start_service: StartService) -> None:
    """Without their supervisor the other processes end by themselves, so that a new one finds free ground."""
    service = start_service()
    encoder = running(service.accepted_slow())
    orphans = {encoder, *service.children("web"), *service.children("worker")}
    service.process.kill()
    service.process.wait()
    wait_until(lambda: not orphans & set(processes()))


def test_poison(start_service: StartService) -> None:
    """A job whose encoder always dies fails after four attempts, with its last error."""
    service = start_service()
    job_id = service.accepted()
    killed: set[int] = set()
    while len(killed) < 4:
        encoder = wait_until(lambda: (number := encoder_of(job_id)) not in killed and number)
        os.kill(encoder or 0, signal.SIGKILL)
        killed.add(encoder or 0)
    job = service.wait(job_id)
    assert (job["state"], job["attempt"], job["result"]) == ("failed", 4, None)
    assert job["error"] == {"code": "crashed", "detail": "the encoder crashed (Killed)"}
    healthy = service.accepted()
    assert service.wait(healthy)["state"] == "done"
    assert_only_results_remain(service, healthy)


def test_timeout(start_service: StartService) -> None:
    """An encode beyond the time-out is ended and not tried again."""
    service = start_service(job_timeout_s=0.5, max_time_limit_s=0.4)
    job_id = service.accepted(SLOW, bpp=1, time_limit_s=0.4)
    job = service.wait(job_id)
    assert (job["state"], job["attempt"], job["error"]["code"]) == ("failed", 1, "timed_out")
    assert encoder_of(job_id) is None
    wait_until(lambda: service.files() == [])


def test_removing_a_running_job(start_service: StartService) -> None:
    """DELETE ends the encode, and the worker goes on with the next job."""
    service = start_service()
    job_id, next_id = service.accepted_slow(), service.accepted()
    encoder = running(job_id)
    assert service.client.delete(f"/jobs/{job_id}").status_code == 204
    wait_until(lambda: encoder not in processes())
    assert service.wait(next_id)["attempt"] == 1
    assert_only_results_remain(service, next_id)


def test_sleeping_worker(start_service: StartService) -> None:
    """A worker that sleeps beyond its lease and wakes up again cannot publish what another did."""
    service = start_service(workers=2)
    job_id = service.accepted_slow()
    encoder = running(job_id)
    sleeper = parent_of(encoder)
    os.kill(sleeper, signal.SIGSTOP)
    try:
        wait_until(lambda: service.job(job_id)["attempt"] == 2)
        assert encoder in processes()
    finally:
        os.kill(sleeper, signal.SIGCONT)
    wait_until(lambda: encoder not in processes())
    assert service.job(job_id)["state"] == "running"
    assert service.job(job_id)["attempt"] == 2
    assert service.client.delete(f"/jobs/{job_id}").status_code == 204


def test_memory_limit(start_service: StartService) -> None:
    """An encode that wants more memory than it may have crashes, and nothing else does."""
    service = start_service(job_memory_bytes=2**28, max_attempts=1)
    job = service.wait(service.accepted_slow())
    assert (job["state"], job["error"]["code"]) == ("failed", "crashed")
    assert service.client.get("/livez").status_code == 200
