"""The JSON of every response, which the OpenAPI document describes."""

from __future__ import annotations

import time
from collections.abc import Sequence
from datetime import datetime

from pydantic import BaseModel, Field

from service.jobs.job import Job, JobError, JobState, JsonObject, Priority
from service.settings import Settings
from sgmethod.trace import seconds_left

Figure = float | int | str | None

EXAMPLE_ID = "5f1c0e9ab0d4467f8a3d2b6c7e8f9012"


class AcceptedView(BaseModel):
    """The answer to POST /encode."""

    id: str = Field(description="32 hexadecimal digits; without API keys, anyone who knows the id can read the job")
    status_url: str
    decode_url: str
    bitstream_url: str


class BudgetView(BaseModel):
    """The budget of an encode."""

    kind: str = Field(description='"bpp", "bytes", "quality", "psnr" or "gaussians"')
    value: float
    max_bpp: float | None = Field(description="limit in bits per pixel beside the default quality, else null")


class ImageView(BaseModel):
    """The source image, from its header."""

    format: str
    width: int = Field(description="pixels")
    height: int = Field(description="pixels")
    bytes: int


class JobSummary(AcceptedView):
    """A job without its position and trace."""

    state: JobState
    budget: BudgetView
    profile: str
    tune: str = Field(description='"psnr", "fidelity" or "visual"')
    effort: int = Field(description="1 (fastest) to 9 (best file)")
    time_limit_s: float
    priority: Priority
    image: ImageView
    attempt: int = Field(description="number of times the job has been started")
    created_at: datetime
    started_at: datetime | None = Field(description="start of the latest attempt")
    finished_at: datetime | None
    expires_at: datetime | None = Field(description="when the finished job is deleted")
    image_expires_at: datetime | None = Field(description="until when the image of the finished job can be re-encoded")
    result: dict[str, Figure | list[str]] | None = Field(
        description="figures of the finished file; warnings has one sentence each for a missed target, a file larger "
        "than its source, a file without Gaussians, and a time limit that cut the encode short on a busy machine; "
        "advice and better name a format that suits the image better"
    )
    notes: list[str] = Field(description="what was dropped from the image, once done")
    error: JobError | None = Field(description="once failed")


class JobView(JobSummary):
    """A job with its position and trace."""

    position: int | None = Field(description="position in the queue, from 1, while queued")
    progress: float = Field(description="estimated progress, 0 to 1; never decreases")
    seconds_left: float | None = Field(description="estimate while the job is running, once there is one")
    trace: list[dict[str, Figure]] = Field(
        description="seconds, step, steps, psnr (dB), bytes, gaussians, phase and share (the part of the time that is "
        "over), oldest first; sparser with time"
    )


class JobPage(BaseModel):
    """Jobs, newest first."""

    jobs: list[JobSummary]
    next: str | None = Field(description="URL of the next page, if there are older jobs")


class LinksView(BaseModel):
    """URLs that need no key until they expire."""

    decode_url: str = Field(description="URL of the picture; its extension and view parameters can be changed")
    bitstream_url: str
    expires_at: datetime


def accepted(job: Job, settings: Settings) -> AcceptedView:
    """Return the job's id and the paths of its resources."""
    return AcceptedView(
        id=job.id,
        status_url=f"{settings.root_path}/jobs/{job.id}",
        decode_url=f"{settings.root_path}/decode/{job.id}.png",
        bitstream_url=f"{settings.root_path}/bitstreams/{job.id}.sg",
    )


def expires_at(job: Job, settings: Settings) -> float | None:
    """Return when the job is removed, in seconds since 1970; None if it is not finished, or is kept for ever."""
    kept_s = settings.retention_s
    return job.finished_at + kept_s if job.finished_at is not None and kept_s else None


def summary(job: Job, settings: Settings) -> JobSummary:
    """Return the job without its position and trace."""
    return JobSummary.model_validate(_members(job, settings))


def with_trace(job: Job, position: int | None, trace: Sequence[JsonObject], settings: Settings) -> JobView:
    """Return the job with its position, trace and progress."""
    # The greatest share, since a second try at a PSNR begins anew.
    progress = 1.0 if job.state == "done" else max((point.get("share", 0.0) for point in trace), default=0.0)
    left_s = None
    if job.state == "running" and job.started_at is not None:
        left_s = seconds_left(trace, time.time() - job.started_at, job.request.time_limit_s)
    figures = {"position": position, "progress": progress, "seconds_left": left_s, "trace": trace}
    return JobView.model_validate({**_members(job, settings), **figures})


def _members(job: Job, settings: Settings) -> JsonObject:
    """Return the fields of a summary: those of the job and its request, and the rest here. pydantic converts times."""
    request, image, stats = job.request, job.image, job.result.stats if job.result else {}
    return {
        **vars(request),
        **vars(job),
        **vars(accepted(job, settings)),
        "budget": BudgetView(kind=request.budget_kind, value=request.budget_value, max_bpp=request.budget_max_bpp),
        "image": ImageView(format=image.format, width=image.width, height=image.height, bytes=image.size_bytes),
        "expires_at": expires_at(job, settings),
        "image_expires_at": None if job.finished_at is None else job.finished_at + settings.source_retention_s,
        "result": {name: value for name, value in stats.items() if name != "notes"} if job.result else None,
        "notes": stats.get("notes", []),
        # A queued job may have the error of its last crash, which clients do not need.
        "error": job.error if job.state == "failed" else None,
    }
