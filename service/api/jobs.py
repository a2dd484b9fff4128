"""Handlers of existing jobs: get, list, link and remove."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from typing import Annotated

from fastapi import Query, Request, Response
from pydantic import Field

from service.api import models
from service.api.context import JobId, UseCaller, UseContext, known_job
from service.api.problems import ProblemError
from service.api.requests import NEVER_STORED, Parameters
from service.jobs.job import JobState
from service.keys import Link
from service.storage.files import keys_of

MAX_LINK_S = 7 * 86_400


class PageQuery(Parameters):
    """Query parameters of a page of jobs."""

    limit: int = Field(default=50, ge=1, le=200)
    before: int | None = Field(default=None, ge=1, le=2**53)
    state: JobState | None = Field(default=None, description="only jobs in this state")


class LinksQuery(Parameters):
    """Lifetime of the links."""

    expires_s: int = Field(default=3600, ge=1, le=MAX_LINK_S, description="seconds until the links expire")


async def status(job_id: JobId, context: UseContext, request: Request, response: Response) -> models.JobView:
    """Return state, queue position, progress, trace and the result or error."""
    job = await known_job(request, job_id)
    response.headers.update(NEVER_STORED)
    position = await context.read(context.table.position, job) if job.state == "queued" else None
    return models.with_trace(job, position, await context.read(context.table.trace, job.id), context.settings)


async def jobs(
    context: UseContext, caller: UseCaller, response: Response, query: Annotated[PageQuery, Query()]
) -> models.JobPage:
    """List jobs, newest first, in pages; with API keys, only those of the caller's key."""
    response.headers.update(NEVER_STORED)
    limit, settings = query.limit, context.settings
    page = await context.read(context.table.page, limit + 1, query.before, caller.owner, query.state)
    chosen = "" if query.state is None else f"&state={query.state}"
    where = f"{settings.root_path}/jobs?limit={limit}"
    older = f"{where}&before={page[limit - 1].number}{chosen}" if len(page) > limit else None
    return models.JobPage(jobs=[models.summary(job, settings) for job in page[:limit]], next=older)


async def links(
    job_id: JobId,
    context: UseContext,
    request: Request,
    response: Response,
    query: Annotated[LinksQuery, Query()],
) -> models.LinksView:
    """Create links to the picture and the bitstream that anyone can open until they expire.

    404 if the operator has not enabled links.
    """
    job = await known_job(request, job_id)
    response.headers.update(NEVER_STORED)
    secret = context.settings.link_secret.get_secret_value()
    if not secret:
        raise ProblemError(404, "links are not enabled on this server")
    expires = int(time.time()) + query.expires_s
    picture, bitstream = (Link(resource, job.id, expires).query(secret) for resource in ("decode", "bitstreams"))
    known = models.accepted(job, context.settings)
    return models.LinksView(
        decode_url=f"{known.decode_url}?{picture}",
        bitstream_url=f"{known.bitstream_url}?{bitstream}",
        expires_at=datetime.fromtimestamp(expires, UTC),
    )


async def remove(job_id: JobId, context: UseContext, request: Request) -> Response:
    """Cancel the job if it is not done, and delete everything stored for it."""
    job = await known_job(request, job_id)
    removed = await context.write(context.table.remove, job.id)
    if removed is not None:
        # A worker that runs it loses its claim at the next heartbeat, and removes its own files.
        for key in keys_of(removed.id, removed.attempt):
            await context.store(context.discard, key)
    return Response(status_code=204)  # a Response, since JSON would have a Content-Type
