"""What clients see of a job that goes on: progress, its trace, seconds left, errors."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import pytest

from service.api.models import summary, with_trace
from service.jobs.job import Job, JobError, JobState
from service.settings import Settings
from sgmethod.trace import share_of
from tests.support.job_table import CRASH, IMAGE, REQUEST

SETTINGS = Settings()


def job(state: JobState, error: JobError | None = None) -> Job:
    return Job(1, "0" * 32, None, "interactive", state, REQUEST, IMAGE, 1, 0, 0, 0.0, None, None, None, error)


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
    seen = [with_trace(job("running"), None, trace[:length], SETTINGS).progress for length in range(len(trace) + 1)]
    assert seen == sorted(seen)
    assert seen[0] == 0
    assert seen[26] == pytest.approx(0.2, abs=0.02)
    assert seen[52] == pytest.approx(0.38)
    assert with_trace(job("done"), None, [], SETTINGS).progress == 1


@pytest.mark.parametrize(("waited_s", "limit_s", "left_s"), [(3, 60, 7), (5, 60, 5), (30, 60, 0), (3, 6, 3)])
def test_seconds_left(waited_s: float, limit_s: float, left_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now)
    running = replace(job("running"), started_at=now - waited_s)
    running = replace(running, request=replace(running.request, time_limit_s=limit_s))
    trace = [point("fit", 0, 50), point("fit", 40, 50)]
    assert with_trace(running, None, trace, SETTINGS).seconds_left == pytest.approx(left_s, abs=0.2)
    for too_early in (trace[:1], [*trace[:1], point("fit", 5, 50)]):
        assert with_trace(running, None, too_early, SETTINGS).seconds_left is None
    assert with_trace(replace(running, state="queued"), None, trace, SETTINGS).seconds_left is None


def test_the_error_of_a_crash_is_shown_once_the_job_has_failed() -> None:
    assert summary(job("queued", CRASH), SETTINGS).error is None
    shown = summary(job("failed", CRASH), SETTINGS).error
    assert shown is not None
    assert (shown.code, shown.detail) == (CRASH.code, CRASH.detail)
