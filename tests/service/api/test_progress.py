"""What clients see of a job that goes on: progress, its trace, and seconds left."""

from __future__ import annotations

import time
from typing import Any

import pytest

from service.api.jobs import with_trace
from service.jobs.job import Job, JobState
from service.settings import Settings
from sgmethod.trace import share_of
from tests.support.job_table import IMAGE, REQUEST

SETTINGS = Settings()


def job(state: JobState, **more: Any) -> Job:
    kept = {"number": 1, "crashes": 0, "losses": 0, "sha256": "", "result": None, "notes": [], "error": None}
    known = {"id": "0" * 32, "priority": "interactive", "image": IMAGE, "attempt": 1, **kept}
    times = {"created_at": 0.0, "started_at": None, "finished_at": None}
    return Job(state=state, **{**vars(REQUEST), **known, **times, **more})


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
    times = {"started_at": now - waited_s, "time_limit_s": limit_s}
    running = job("running", **times)
    trace = [point("fit", 0, 50), point("fit", 40, 50)]
    assert with_trace(running, None, trace, SETTINGS).seconds_left == pytest.approx(left_s, abs=0.2)
    for too_early in (trace[:1], [*trace[:1], point("fit", 5, 50)]):
        assert with_trace(running, None, too_early, SETTINGS).seconds_left is None
    assert with_trace(job("queued", **times), None, trace, SETTINGS).seconds_left is None
