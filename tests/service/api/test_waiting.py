"""One request is enough: POST /encode that waits for its file."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict

import httpx2
import pytest
from PIL import Image

import sgmethod
from service.api.requests import MAX_WAIT_S
from service.settings import Settings
from sgmethod.budget import DEFAULT_BUDGET
from tests.support.pictures import SMALL
from tests.support.processes import TIMEOUT_S, wait_until
from tests.support.service import Service, StartService, assert_problem

BODY = {"Content-Type": "image/png"}
QUICK = "time_limit_s=0.1"


def test_a_photograph_becomes_a_file(service: Service) -> None:
    """As `curl -F image=@photo.jpg 'http://HOST/encode?wait=50' -o photo.sg` does it: no budget, no second request."""
    answer = service.client.post("/encode?wait=100", files={"image": ("photo.png", SMALL)}, data={"time_limit_s": "1"})
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/octet-stream")
    assert (sgmethod.info(answer.content).width, sgmethod.info(answer.content).height) == (64, 48)
    assert len(answer.content) <= (DEFAULT_BUDGET.max_bytes(64, 48) or 0)
    job = service.client.get(answer.headers["location"]).json()
    assert job["budget"] == asdict(DEFAULT_BUDGET)
    assert service.client.get(job["bitstream_url"]).content == answer.content


PICTURE_ANSWER = {"content-type": "image/webp", "vary": "Accept", "cache-control": "no-store"}


@pytest.mark.parametrize(
    ("query", "headers", "answered"),
    [
        ("&wait=100", {"Accept": "image/webp", "If-None-Match": "*"}, PICTURE_ANSWER),
        ("&wait=100", {"Accept": "image/webp;q=0.9, image/png;q=0.2"}, PICTURE_ANSWER),
        ("&wait=100", {"Accept": "text/html, image/webp"}, PICTURE_ANSWER),
        ("&wait=300", {}, {"content-type": "application/octet-stream"}),
    ],
)
def test_ways_to_wait(quick: Service, query: str, headers: dict[str, str], answered: dict[str, str]) -> None:
    """A long one is cut before a proxy gives up, as the usual one does after 60 s."""
    answer = quick.client.post(f"/encode?{QUICK}{query}", content=SMALL, headers={**BODY, **headers})
    assert answer.status_code == 200
    assert {name: answer.headers[name] for name in answered} == answered
    if answered is PICTURE_ANSWER:
        assert Image.open(io.BytesIO(answer.content)).size == (64, 48)
    assert MAX_WAIT_S < 60


def test_what_is_not_done_in_time_is_a_job(web: Service) -> None:
    """Here it never is."""
    answer = web.client.post("/encode?wait=1", content=SMALL, headers=BODY)
    assert answer.status_code == 202
    assert web.job(answer.json()["id"])["state"] == "queued"


@pytest.mark.parametrize("query", ["wait=x", "wait=-1", "wait=1.5", "wait=", "wiat=1"])
def test_waits_that_are_refused(web: Service, query: str) -> None:
    assert_problem(web.client.post(f"/encode?{query}", content=SMALL, headers=BODY), 422)


def test_a_job_that_fails_or_is_removed_meanwhile(empty: Service) -> None:
    def ask() -> httpx2.Response:
        return httpx2.post(f"{empty.url}/encode?wait=100", content=SMALL, headers=BODY, timeout=200)

    def only_job() -> str:
        jobs = wait_until(lambda: empty.client.get("/jobs?limit=1").json()["jobs"])
        return str(jobs[0]["id"])

    with ThreadPoolExecutor(1) as pool:
        asking = pool.submit(ask)
        job_id = only_job()
        empty.refuse(job_id)
        problem = assert_problem(asking.result(), 422, "it is refused")
        assert (problem["id"], problem["code"]) == (job_id, "refused")
        empty.client.delete(f"/jobs/{job_id}")
        asking = pool.submit(ask)
        empty.client.delete(f"/jobs/{only_job()}")
        assert_problem(asking.result(), 409, "removed")


@pytest.mark.thorough
def test_places_to_wait(start_service: StartService) -> None:
    """Who goes leaves a job, and no place taken. Who finds none gets a job at once. One client has half."""
    web = start_service("web", queue_length=10_000)

    def wait_for(taken: int) -> None:
        wait_until(lambda: web.figures()["sgmethod_waits"] == taken)

    def wait_in(crowd: contextlib.ExitStack) -> None:
        head = f"Host: localhost\r\nContent-Type: image/png\r\nContent-Length: {len(SMALL)}\r\n\r\n"
        lost = crowd.enter_context(web.connect())
        lost.sendall(b"POST /encode?wait=300 HTTP/1.1\r\n" + head.encode() + SMALL)

    with contextlib.ExitStack() as crowd:
        for before in range(Settings.max_waits // 2):
            wait_in(crowd)
            wait_for(taken=before + 1)
        assert web.client.post("/encode?wait=300", content=SMALL, headers=BODY).status_code == 202
    wait_for(taken=0)
    assert len(web.client.get("/jobs?limit=200").json()["jobs"]) == Settings.max_waits // 2 + 1


@pytest.mark.thorough
def test_waits_do_not_hold_up_the_end(start_service: StartService) -> None:
    """Who waits for a file gets the job's state."""
    web = start_service("web", stop_grace_s=2 * TIMEOUT_S)
    asked = {"files": {"image": SMALL}, "timeout": 2 * TIMEOUT_S}
    with ThreadPoolExecutor(1) as pool:
        asking = pool.submit(httpx2.post, f"{web.url}/encode?wait=300", **asked)
        job_id = wait_until(lambda: web.client.get("/jobs").json()["jobs"])[0]["id"]
        assert web.stop() == 0
        assert asking.result().json()["id"] == job_id
    web.start()
    assert web.job(job_id)["state"] == "queued"


@pytest.mark.thorough
def test_reading_the_header_counts_too(start_service: StartService) -> None:
    """On a busy machine that may take long, and a proxy counts from when it has sent the image."""
    web = start_service("web")
    web.accepted()
    sandbox = web.sandbox()
    with ThreadPoolExecutor(1) as pool:
        os.kill(sandbox, signal.SIGSTOP)
        asking = pool.submit(httpx2.post, f"{web.url}/encode?wait=6", content=SMALL, headers=BODY, timeout=100)
        time.sleep(6)
        os.kill(sandbox, signal.SIGCONT)
        began = time.monotonic()
        assert asking.result().status_code == 202
        assert time.monotonic() - began < 6


@pytest.mark.thorough
def test_a_job_table_that_goes_away_meanwhile(start_service: StartService) -> None:
    """The image was accepted: a client that gets Retry-After would submit it again."""
    web = start_service("web")

    def ask() -> httpx2.Response:
        return httpx2.post(f"{web.url}/encode?wait=20", content=SMALL, headers=BODY, timeout=100)

    with ThreadPoolExecutor(1) as pool:
        asking = pool.submit(ask)
        wait_until(lambda: web.client.get("/jobs").json()["jobs"])
        (web.data_dir / "jobs.sqlite3").rename(web.data_dir / "aside")
        answer = asking.result()
    assert (answer.status_code, answer.headers["location"]) == (202, answer.json()["status_url"])


@pytest.mark.parametrize("path", ["/jobs/{}/links", "/jobs/{}"])
def test_no_body_is_ignored(empty: Service, path: str) -> None:
    job_id = empty.accepted()
    method = "DELETE" if path == "/jobs/{}" else "POST"
    answer = empty.client.request(method, path.format(job_id), data={"expires_s": "60"})
    assert_problem(answer, 422, "no body")
    assert empty.job(job_id)["state"] == "queued"
