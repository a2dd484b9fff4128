"""What clients see of a job that goes on: progress, its trace, and streams of server-sent events."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import httpx
import pytest

from service.api.models import summary, with_trace
from service.jobs.job import Job, JobError, JobState
from service.settings import Settings
from sgmethod.trace import share_of
from tests.support.data import PICTURE
from tests.support.job_table import CRASH, IMAGE, REQUEST
from tests.support.pictures import SMALL
from tests.support.processes import PATIENCE_S, wait_until
from tests.support.service import Service, StartService, assert_problem

Event = tuple[str, dict[str, Any]]
TRACED = ("progress", "seconds_left", "trace")  # not in the events of states
SETTINGS = Settings()


def read(answer: httpx.Response) -> Iterator[Event]:
    """Events by name with their data, until the stream ends."""
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/event-stream")
    name = ""
    for line in answer.iter_lines():
        if line.startswith("event: "):
            name = line.removeprefix("event: ")
        elif line.startswith("data: "):
            yield name, json.loads(line.removeprefix("data: "))


@contextlib.contextmanager
def stream(service: Service, job_id: str) -> Iterator[Iterator[Event]]:
    with httpx.stream("GET", f"{service.url}/jobs/{job_id}/events", timeout=PATIENCE_S) as answer:
        yield read(answer)


def test_a_job_from_the_queue_to_its_result(quick: Service) -> None:
    job_id = quick.accepted(SMALL, bpp=2, time_limit_s=2)
    with stream(quick, job_id) as events:
        seen = list(events)
    names = [name for name, _ in seen]
    assert (names[0], names[-1]) == ("state", "done")
    assert "trace" in names
    states = [data["state"] for name, data in seen if name == "state"]
    assert states == sorted(states, key=["queued", "running", "done"].index)
    progress = [data["progress"] for name, data in seen if name == "trace"]
    assert progress == sorted(progress)
    job = quick.job(job_id)
    assert seen[-1][1] == {name: value for name, value in job.items() if name not in TRACED}
    points = [point for name, data in seen if name == "trace" for point in data["trace"]]
    assert points == job["trace"]


def test_a_job_that_is_done_already_fails_or_is_removed(web: Service) -> None:
    with stream(web, web.published(PICTURE)) as events:
        assert [name for name, _ in events] == ["state", "done"]
    failing = web.accepted()
    with stream(web, failing) as events:
        assert next(events)[1]["state"] == "queued"
        web.refuse(failing)
        *_, (name, job) = events
    assert (name, job["error"]["code"]) == ("failed", "refused")
    removed = web.accepted()
    with stream(web, removed) as events:
        assert next(events)[1]["state"] == "queued"
        assert web.client.delete(f"/jobs/{removed}").status_code == 204
        assert list(events) == [("removed", {})]
    assert_problem(web.client.get(f"/jobs/{removed}/events"), 404)


@pytest.mark.thorough
def test_a_job_table_that_goes_away(start_service: StartService) -> None:
    """The stream ends, and can be opened again once the table is back."""
    web = start_service("web")
    job_id = web.accepted()
    file, aside = web.data_dir / "jobs.sqlite3", web.data_dir / "aside"
    with stream(web, job_id) as events:
        assert next(events)[1]["state"] == "queued"
        file.rename(aside)
        assert list(events) == []
    assert_problem(web.client.get(f"/jobs/{job_id}/events"), 503)
    aside.rename(file)
    with stream(web, job_id) as events:
        assert next(events)[1]["state"] == "queued"
    assert "Traceback" not in web.log.read_text()


@pytest.mark.thorough
def test_neither_streams_nor_waits_hold_up_the_end(start_service: StartService) -> None:
    """Who waits for a file gets the job's state."""
    web = start_service("web", stop_grace_s=2 * PATIENCE_S)
    asked = {"files": {"image": SMALL}, "timeout": 2 * PATIENCE_S}
    with ThreadPoolExecutor(1) as pool:
        asking = pool.submit(httpx.post, f"{web.url}/encode?wait=300", **asked)
        job_id = wait_until(lambda: web.client.get("/jobs").json()["jobs"])[0]["id"]
        with stream(web, job_id) as events:
            next(events)
            assert web.stop() == 0
            # A stream that the server had cut off, as it does at half of the grace time, would raise an error here.
            assert "done" not in [name for name, _ in events]
        assert asking.result().json()["id"] == job_id
    web.start()
    assert web.job(job_id)["state"] == "queued"


def job(state: JobState, error: JobError | None = None) -> Job:
    return Job(1, "0" * 32, None, "interactive", state, None, REQUEST, IMAGE, 1, 0, 0, 0.0, None, None, None, error, 0)


def point(phase: str, step: int, steps: int) -> dict[str, Any]:
    share = share_of(phase, step, steps)
    return {"phase": phase, "step": step, "steps": steps, "psnr": 30.0, "seconds": 10 * share, "share": share}


def test_progress_never_falls() -> None:
    trace = [
        point("start", 0, 0),
        *(point("fit", step, 50) for step in range(51)),
        *(point("tune", step, 30) for step in range(31)),
        *(point("fit", step, 50) for step in range(51)),  # a second try at a PSNR
    ]
    seen = [with_trace(job("running"), trace[:length], SETTINGS).progress for length in range(len(trace) + 1)]
    assert seen == sorted(seen)
    assert seen[0] == 0
    assert seen[26] == pytest.approx(0.2, abs=0.02)
    assert seen[52] == pytest.approx(0.38)
    assert with_trace(job("done"), [], SETTINGS).progress == 1


@pytest.mark.parametrize(("waited_s", "limit_s", "left_s"), [(3, 60, 7), (5, 60, 5), (30, 60, 0), (3, 6, 3)])
def test_seconds_left(waited_s: float, limit_s: float, left_s: float) -> None:
    running = replace(job("running"), started_at=time.time() - waited_s)
    running = replace(running, request=replace(running.request, time_limit_s=limit_s))
    trace = [point("fit", 0, 50), point("fit", 40, 50)]
    assert with_trace(running, trace, SETTINGS).seconds_left == pytest.approx(left_s, abs=0.2)
    for too_early in (trace[:1], [*trace[:1], point("fit", 5, 50)]):
        assert with_trace(running, too_early, SETTINGS).seconds_left is None
    assert with_trace(replace(running, state="queued"), trace, SETTINGS).seconds_left is None


def test_the_error_of_a_crash_is_shown_once_the_job_has_failed() -> None:
    assert summary(job("queued", CRASH), SETTINGS).error is None
    shown = summary(job("failed", CRASH), SETTINGS).error
    assert shown is not None
    assert (shown.code, shown.detail) == (CRASH.code, CRASH.detail)
