"""Jobs: their JSON, the wait for one, and the handlers that get, list, link and remove them."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Annotated, Any, Self

from fastapi import Query, Response
from pydantic import BaseModel, Field

from service.api.context import Call, Context, JobId, UseCall
from service.api.metrics import WAITED_S
from service.api.problems import ProblemError
from service.api.requests import NEVER_STORED, Parameters, while_client_waits
from service.api.sending import removed_at
from service.errors import JobTableError
from service.jobs.job import FINAL_STATES, Figure, Id, Job, JobState, JsonObject, Time, is_job_id
from service.keys import Link
from service.settings import Settings
from service.storage.files import discard, keys_of
from sgmethod.trace import seconds_left

EXAMPLE_ID = "5f1c0e9ab0d4467f8a3d2b6c7e8f9012"
MAX_LINK_S = 7 * 86_400
FIRST_POLL_S, POLL_S = 0.05, 0.2  # shorter at first, for small pictures


class AcceptedView(BaseModel):
    """The answer to POST /encode."""

    id: Id
    status_url: str
    decode_url: str
    bitstream_url: str


class JobSummary(Job, AcceptedView):
    """A job without its position and trace."""

    expires_at: Time | None = Field(description="when the finished job is deleted")
    image_expires_at: Time | None = Field(description="until when the image of the finished job can be re-encoded")

    @classmethod
    def of(cls, job: Job, settings: Settings, **more: Any) -> Self:
        """Return the job with the members that depend on settings, and more."""
        image_until = None if job.finished_at is None else job.finished_at + settings.source_retention_s
        ends = {"expires_at": removed_at(job, settings), "image_expires_at": image_until}
        return cls(**{**vars(job), **vars(accepted(job, settings)), **ends, **more})


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
    expires_at: Time


class PageQuery(Parameters):
    """Query parameters of a page of jobs."""

    limit: int = Field(default=50, ge=1, le=200)
    before: int | None = Field(default=None, ge=1, le=2**53)
    state: JobState | None = Field(default=None, description="only jobs in this state")


class LinksQuery(Parameters):
    """Lifetime of the links."""

    expires_s: int = Field(default=3600, ge=1, le=MAX_LINK_S, description="seconds until the links expire")


def no_such_job() -> ProblemError:
    """Return the answer to an id without a job, whether or not the id is well formed."""
    return ProblemError(404, "there is no such job")


async def known_job(call: Call, job_id: str) -> Job:
    """Return the job if the caller may see it. A job of another owner looks like none. Raises ProblemError 404."""
    if not is_job_id(job_id) or call.caller.linked_job not in (None, job_id):
        raise no_such_job()
    job = await call.context.read(call.context.table.get, job_id, call.caller.owner)
    if job is None:
        raise no_such_job()
    return job


async def waited(call: Call, job: Job, deadline: float) -> Job:
    """Return the job once it has ended, or as it is at the deadline, and where no place to wait is free."""
    began, waits, client = time.monotonic(), call.context.waits, call.caller.client
    if not waits.is_full_for(client):
        with waits.hold(client), suppress(JobTableError, OSError):
            ending = _ended(call.context, job, deadline)
            try:
                job = await while_client_waits(call.request, ending)
            finally:
                setattr(call.request.state, WAITED_S, time.monotonic() - began)
    return job


async def _ended(context: Context, job: Job, deadline: float) -> Job:
    """Return the job once it has ended, or at the deadline. Raises ProblemError 409 if it is removed meanwhile."""
    pause_s = FIRST_POLL_S
    while job.state not in FINAL_STATES and time.monotonic() < deadline and not context.stopping():
        pause_s = min(1.1 * pause_s, POLL_S)
        await asyncio.sleep(pause_s)
        seen = await context.read(context.table.get, job.id)
        if seen is None:
            raise ProblemError(409, "the job was removed before it was done")
        job = seen
    return job


async def status(call: UseCall, job_id: JobId, response: Response) -> JobView:
    """Return state, queue position, progress, trace and the result or error."""
    context, job = call.context, await known_job(call, job_id)
    response.headers.update(NEVER_STORED)
    position = await context.read(context.table.position, job) if job.state == "queued" else None
    return with_trace(job, position, await context.read(context.table.trace, job.id), context.settings)


async def jobs(call: UseCall, response: Response, query: Annotated[PageQuery, Query()]) -> JobPage:
    """List jobs, newest first, in pages; with API keys, only those of the caller's key."""
    response.headers.update(NEVER_STORED)
    context, limit, settings = call.context, query.limit, call.context.settings
    page = await context.read(context.table.page, limit + 1, query.before, call.caller.owner, query.state)
    chosen = "" if query.state is None else f"&state={query.state}"
    where = f"{settings.root_path}/jobs?limit={limit}"
    older = f"{where}&before={page[limit - 1].number}{chosen}" if len(page) > limit else None
    return JobPage(jobs=[JobSummary.of(job, settings) for job in page[:limit]], next=older)


async def links(call: UseCall, job_id: JobId, response: Response, query: Annotated[LinksQuery, Query()]) -> LinksView:
    """Create links to the picture and the bitstream that anyone can open until they expire.

    404 if the operator has not enabled links.
    """
    job, settings = await known_job(call, job_id), call.context.settings
    response.headers.update(NEVER_STORED)
    secret = settings.link_secret.get_secret_value()
    if not secret:
        raise ProblemError(404, "links are not enabled on this server")
    expires = int(time.time()) + query.expires_s
    picture, bitstream = (Link(resource, job.id, expires).query(secret) for resource in ("decode", "bitstreams"))
    known = accepted(job, settings)
    return LinksView(
        decode_url=f"{known.decode_url}?{picture}",
        bitstream_url=f"{known.bitstream_url}?{bitstream}",
        expires_at=expires,
    )


async def remove(call: UseCall, job_id: JobId) -> Response:
    """Cancel the job if it is not done, and delete everything stored for it."""
    context, job = call.context, await known_job(call, job_id)
    removed = await context.write(context.table.remove, job.id)
    if removed is not None:
        # A worker that runs it loses its claim at the next heartbeat, and removes its own files.
        for key in keys_of(removed.id, removed.attempt):
            await context.store(discard, context.storage, key)
    return Response(status_code=204)  # a Response, since JSON would have a Content-Type


def accepted(job: Job, settings: Settings) -> AcceptedView:
    """Return the job's id and the paths of its resources."""
    return AcceptedView(
        id=job.id,
        status_url=f"{settings.root_path}/jobs/{job.id}",
        decode_url=f"{settings.root_path}/decode/{job.id}.png",
        bitstream_url=f"{settings.root_path}/bitstreams/{job.id}.sg",
    )


def with_trace(job: Job, position: int | None, trace: Sequence[JsonObject], settings: Settings) -> JobView:
    """Return the job with its position, trace and progress."""
    # The greatest share, since a second try at a PSNR begins anew.
    progress = 1.0 if job.state == "done" else max((point.get("share", 0.0) for point in trace), default=0.0)
    left_s = None
    if job.state == "running" and job.started_at is not None:
        left_s = seconds_left(trace, time.time() - job.started_at, job.time_limit_s)
    return JobView.of(job, settings, position=position, progress=progress, seconds_left=left_s, trace=trace)
