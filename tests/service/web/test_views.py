"""What clients see of a trace."""

from __future__ import annotations

from typing import Any

import pytest

from service.api.models import MAX_TRACE_POINTS, summary, with_trace
from service.jobs.job import EncodeRequest, Job, JobError, JobState, SourceImage
from service.settings import Settings

SETTINGS = Settings()


def job(state: JobState, error: JobError | None = None) -> Job:
    request, image = EncodeRequest("bpp", 1.0, "paper", 60.0), SourceImage("PNG", 8, 8, 10)
    return Job(1, "0" * 32, None, "interactive", state, None, request, image, 1, 0, 0.0, None, None, None, error, 0)


def point(phase: str, step: int, steps: int) -> dict[str, Any]:
    return {"phase": phase, "step": step, "steps": steps, "psnr": 30.0}


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
    assert seen[26] == pytest.approx(0.3, abs=0.02)
    assert seen[52] == pytest.approx(0.6)
    assert with_trace(job("done"), [], SETTINGS).progress == 1


@pytest.mark.parametrize("length", [0, 1, MAX_TRACE_POINTS, MAX_TRACE_POINTS + 1, 10 * MAX_TRACE_POINTS + 7])
def test_a_long_trace_is_thinned(length: int) -> None:
    trace = [point("fit", step, length) for step in range(length)]
    steps = [int(shown["step"] or 0) for shown in with_trace(job("running"), trace, SETTINGS).trace]
    assert len(steps) == min(length, MAX_TRACE_POINTS)
    assert steps == sorted(set(steps))
    if length:
        assert (steps[0], steps[-1]) == (0, length - 1)


def test_the_error_of_a_crash_is_shown_once_the_job_has_failed() -> None:
    error = JobError("crashed", "it crashed")
    assert summary(job("queued", error), SETTINGS).error is None
    shown = summary(job("failed", error), SETTINGS).error
    assert shown is not None
    assert (shown.code, shown.detail) == ("crashed", "it crashed")
