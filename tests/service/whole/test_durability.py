"""The rules of durability, each under fire: real processes, either database.

The codec is a fake, but where an encode takes too long: it is the processes around it that are tested.

After everything that happens here, each accepted job has ended, none was published twice, and nothing is
left over but the bitstreams of those that are done.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sqlite3
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import httpx2
import pytest

from service.sandbox.client import KILLED
from tests.support.data import PICTURE
from tests.support.pictures import SLOW, SMALL
from tests.support.processes import (
    TIMEOUT_S,
    Kind,
    encoder_of,
    end_early,
    processes,
    running_encoder,
    wait_until,
    worker_of,
)
from tests.support.service import FAKE_CODEC, Service, StartService


@pytest.fixture
def start_service(start_service: StartService, database_url: str) -> StartService:
    """Every test here runs once on either database."""
    return partial(start_service, database_url=database_url)


@pytest.fixture(scope="module")
def one_worker(new_table: Callable[[], str], start_for_module: StartService) -> Service:
    """A service for all tests that leave it as they found it."""
    return start_for_module(database_url=new_table(), extra=FAKE_CODEC)


@pytest.fixture(scope="module")
def two_workers(new_table: Callable[[], str], start_for_module: StartService) -> Service:
    """The same with two workers, and leases long enough that a worker on a busy machine is not taken for lost."""
    return start_for_module(database_url=new_table(), workers=2, lease_s=4, extra=FAKE_CODEC)


@pytest.fixture
def solo(one_worker: Service) -> Iterator[Service]:
    """A service with one worker and no jobs."""
    yield one_worker
    one_worker.clear()


@pytest.fixture
def duo(two_workers: Service) -> Iterator[Service]:
    """A service with two workers and no jobs."""
    yield two_workers
    two_workers.clear()


@contextlib.contextmanager
def asleep(service: Service, job_id: str) -> Iterator[None]:
    """Stop the worker of a job's first attempt for a while, at a moment when it does not hold SQLite's lock, for which
    all others would wait until it wakes up again. PostgreSQL ends such a transaction by itself.
    """
    table, worker = service.data_dir / "jobs.sqlite3", worker_of(service.log, job_id)

    def sleeps() -> bool:
        os.kill(worker, signal.SIGSTOP)
        wait_until(lambda: Path(f"/proc/{worker}/stat").read_text().rpartition(")")[2].split()[0] == "T")
        if not table.exists():
            return True
        with contextlib.closing(sqlite3.connect(table, timeout=0, isolation_level=None)) as db:
            try:
                db.execute("BEGIN IMMEDIATE")
            except sqlite3.OperationalError:
                os.kill(worker, signal.SIGCONT)
                return False
        return True

    wait_until(sleeps)
    try:
        yield
    finally:
        os.kill(worker, signal.SIGCONT)


def assert_settled(service: Service, *done: str) -> None:
    """These jobs are done and all others have failed or are deleted; nothing runs, and nothing is left over."""
    jobs = service.client.get("/jobs?limit=200").json()["jobs"]
    assert {job["id"] for job in jobs if job["state"] == "done"} == set(done)
    assert {job["state"] for job in jobs} <= {"done", "failed"}
    wait_until(lambda: not service.ours("encoder"))
    published = sorted(f"bitstreams/{job['id']}.{job['attempt']}.sg" for job in jobs if job["state"] == "done")
    wait_until(lambda: service.files() == published)
    for job_id in done:
        assert service.client.get(f"/bitstreams/{job_id}.sg").status_code == 200


def test_rule_1_accepted_jobs_survive_the_web_process(solo: Service) -> None:
    """The web process is killed right after its 202: the encode goes on, and requests find its successor."""
    job_id = solo.accepted_slow(1)
    (web,) = solo.ours("web")
    os.kill(web, signal.SIGKILL)
    solo.client.close()
    solo.client = httpx2.Client(base_url=solo.url, timeout=TIMEOUT_S)
    assert solo.wait(job_id)["attempt"] == 1
    assert solo.ours("web") != [web]
    assert_settled(solo, job_id)


@pytest.mark.thorough
def test_rule_1_accepted_jobs_survive_everything(start_service: StartService) -> None:
    """All processes are killed, one job being encoded and one just accepted: both are done after the next start."""
    service = start_service(extra=FAKE_CODEC)
    first = service.accepted_slow()
    running_encoder(first)
    second = service.accepted()
    service.kill_all()
    service.start()
    end_early(running_encoder(first))
    assert [service.wait(job_id)["attempt"] for job_id in (first, second)] == [2, 1]
    assert_settled(service, first, second)


@pytest.mark.thorough
def test_rule_1_one_key_one_job(start_service: StartService) -> None:
    """The same Idempotency-Key several times at once: one job, one source."""
    service = start_service("web")
    with ThreadPoolExecutor(6) as pool:
        answers = list(pool.map(lambda _: service.post(key="the-same"), range(6)))
    assert {answer.status_code for answer in answers} == {202}
    ids = {answer.json()["id"] for answer in answers}
    assert len(ids) == 1
    assert [job["id"] for job in service.client.get("/jobs").json()["jobs"]] == list(ids)
    assert service.files() == [f"sources/{ids.pop()}"]


def test_rule_2_a_sleeping_worker_has_lost_its_job(duo: Service) -> None:
    """A worker that sleeps beyond its lease ends its encoder when it wakes up, and changes nothing."""
    job_id = duo.accepted_slow()
    encoder = running_encoder(job_id)
    with asleep(duo, job_id):
        wait_until(lambda: duo.job(job_id)["attempt"] == 2)
        assert encoder in processes()
    wait_until(lambda: encoder not in processes())
    job = duo.job(job_id)
    assert (job["state"], job["attempt"]) == ("running", 2)
    assert duo.client.delete(f"/jobs/{job_id}").status_code == 204
    wait_until(lambda: not duo.ours("encoder"))
    assert_settled(duo)


def test_rule_3_published_once(duo: Service) -> None:
    """A worker sleeps while its encoder finishes; another publishes; the first wakes up with a result in hand."""
    job_id = duo.accepted_slow()
    encoder = running_encoder(job_id)
    with asleep(duo, job_id):
        end_early(encoder)
        wait_until(lambda: encoder not in processes())
        end_early(running_encoder(job_id))
        job = duo.wait(job_id)
    wait_until(lambda: f"job {job_id}: attempt 1 was deleted or taken over" in duo.log.read_text())
    assert job["attempt"] == 2
    assert duo.job(job_id) == job
    assert_settled(duo, job_id)


@pytest.mark.parametrize("kind", ["encoder", "worker", "sandbox"])
def test_rules_4_and_5_whoever_is_killed(solo: Service, kind: Kind) -> None:
    """The encode ends, and another attempt at the job comes to its end. The job of a worker goes to the next one when
    its lease is over; requests wait for the successor of a sandbox, which costs no attempt."""
    job_id = solo.accepted_slow()
    encoder = running_encoder(job_id)
    victim = solo.sandbox() if kind == "sandbox" else solo.ours(kind)[0]
    os.kill(victim, signal.SIGKILL)
    assert solo.client.post("/decode", content=PICTURE).status_code == 200
    wait_until(lambda: encoder not in processes())
    end_early(running_encoder(job_id))
    job = solo.wait(job_id)
    assert (job["state"], job["attempt"], job["error"]) == ("done", 2, None)
    assert victim not in processes()
    assert_settled(solo, job_id)


def test_rule_4_cancelled_in_every_state(solo: Service) -> None:
    """DELETE of a running job ends its encoder; in any state nothing remains of the job."""
    done = solo.accepted()
    failed = solo.accepted(SMALL[: len(SMALL) // 2])
    assert [solo.wait(job_id)["state"] for job_id in (done, failed)] == ["done", "failed"]
    current, waiting, last = solo.accepted_slow(), solo.accepted(), solo.accepted()
    encoder = running_encoder(current)
    for job_id in (waiting, current, done, failed):
        assert solo.client.delete(f"/jobs/{job_id}").status_code == 204
        for address in (f"/jobs/{job_id}", f"/bitstreams/{job_id}.sg", f"/decode/{job_id}.png"):
            assert solo.client.get(address).status_code == 404
        assert solo.client.delete(f"/jobs/{job_id}").status_code == 404
    wait_until(lambda: encoder not in processes())
    assert solo.wait(last)["attempt"] == 1
    assert_settled(solo, last)


@pytest.mark.thorough
def test_rule_4_timed_out(start_service: StartService) -> None:
    """An encode that has used up its processor time is not tried again. One that had none in twice its limit is."""
    service = start_service(max_time_limit_s=2, extra=FAKE_CODEC)
    starved = service.accepted(SLOW, bpp=1, time_limit_s=2)
    encoder = running_encoder(starved)
    os.kill(encoder, signal.SIGSTOP)
    job = service.wait(starved, "queued", "failed")
    assert (job["state"], job["attempt"]) == ("queued", 1)
    wait_until(lambda: encoder not in processes())
    spent = service.accepted(SLOW, bpp=1, time_limit_s=2)
    os.kill(running_encoder(spent), signal.SIGPROF)
    job = service.wait(spent)
    assert (job["state"], job["attempt"], job["error"]["code"]) == ("failed", 1, "timed_out")
    service.client.delete(f"/jobs/{starved}")
    assert_settled(service)


@pytest.mark.thorough
def test_rule_5_poison(solo: Service) -> None:
    """A job whose encoder always dies fails after four attempts, with its last error."""
    job_id = solo.accepted_slow()
    killed: set[int] = set()
    while len(killed) < 4:
        encoder = wait_until(lambda: (number := encoder_of(job_id)) not in killed and number)
        os.kill(encoder or 0, signal.SIGKILL)
        killed.add(encoder or 0)
    job = solo.wait(job_id)
    assert (job["state"], job["attempt"], job["result"]) == ("failed", 4, None)
    assert job["error"] == {"code": "crashed", "detail": f"{KILLED}: the encode needs more than there is"}
    healthy = solo.accepted()
    assert solo.wait(healthy)["state"] == "done"
    assert_settled(solo, healthy)


@pytest.mark.thorough
def test_stopping_hands_the_job_back(start_service: StartService) -> None:
    """SIGTERM: exit status 0, no process left, and the job waits unharmed at its place."""
    service = start_service(stop_grace_s=TIMEOUT_S, extra=FAKE_CODEC)
    job_id = service.accepted_slow()
    encoder = running_encoder(job_id)
    ours = {service.process.pid, encoder, *service.ours("web"), *service.ours("worker")}
    assert service.stop() == 0
    wait_until(lambda: not ours & set(processes()))  # a killed process disappears a moment later
    service.start()
    assert service.wait(job_id, "running", "failed")["state"] == "running"
    assert service.job(job_id)["attempt"] == 2
    assert service.client.delete(f"/jobs/{job_id}").status_code == 204
