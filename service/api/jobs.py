"""Jobs: looked at, listed, linked to, stopped, removed."""

from __future__ import annotations

import time
from typing import Annotated

from fastapi import Query, Response
from pydantic import BaseModel, ConfigDict, Field

from service.api import models
from service.api.context import KnownJob, UseCaller, UseContext, no_such_job
from service.api.files import NEVER_STORED
from service.api.problems import ProblemError
from service.jobs.job import JobState
from service.keys import Link
from service.storage.files import source_key

LONGEST_LINK_S = 7 * 86_400


class PageQuery(BaseModel):
    """Which jobs are listed."""

    model_config = ConfigDict(extra="forbid")

    limit: int = Field(default=50, ge=1, le=200)
    before: int | None = Field(default=None, ge=1, le=2**53)
    state: JobState | None = Field(default=None, description="only jobs in this state")


class LinksQuery(BaseModel):
    """For how long links hold."""

    model_config = ConfigDict(extra="forbid")

    expires_s: int = Field(default=3600, ge=1, le=LONGEST_LINK_S, description="seconds until the links expire")


def status(job: KnownJob, context: UseContext, response: Response) -> models.JobView:
    """State, queue position, progress, trace so far, and the result or error."""
    response.headers.update(NEVER_STORED)
    return models.with_trace(job, context.table.trace(job.id), context.settings)


def jobs(
    context: UseContext, caller: UseCaller, response: Response, query: Annotated[PageQuery, Query()]
) -> models.JobPage:
    """All jobs, newest first, in pages; with API keys, only those of the caller's key."""
    response.headers.update(NEVER_STORED)
    limit, settings = query.limit, context.settings
    page = context.table.page(limit + 1, query.before, caller.owner, query.state)
    chosen = "" if query.state is None else f"&state={query.state}"
    where = f"{settings.root_path}/jobs?limit={limit}"
    older = f"{where}&before={page[limit - 1].number}{chosen}" if len(page) > limit else None
    return models.JobPage(jobs=[models.summary(job, settings) for job in page[:limit]], next=older)


def links(
    job: KnownJob, context: UseContext, response: Response, query: Annotated[LinksQuery, Query()]
) -> models.LinksView:
    """Links to the picture and the bitstream that anyone can open until they expire."""
    response.headers.update(NEVER_STORED)
    secret = context.settings.link_secret.get_secret_value()
    if not secret:
        raise ProblemError(404, "links are not enabled on this server")
    expires = int(time.time()) + query.expires_s
    picture, bitstream = (Link(resource, job.id, expires).query(secret) for resource in ("decode", "bitstreams"))
    return models.links(job, picture, bitstream, expires, context.settings)


def stop(job: KnownJob, context: UseContext, response: Response) -> models.AcceptedView:
    """Finish a running job early and keep its result, which stays within the budget. This takes about a quarter of the
    time spent so far. A finished job is unchanged; 409 for a queued or failed one, which has no result to keep.
    """
    view = models.accepted(job, context.settings)
    response.headers.update({"Location": view.status_url, **NEVER_STORED})
    if job.state != "done" and not context.table.stop(job.id):
        now = context.table.get(job.id)
        if now is None:
            raise no_such_job()
        if now.state != "done":
            raise ProblemError(409, f"the job is {now.state}: there is no result to keep", state=now.state)
    return view


def remove(job: KnownJob, context: UseContext) -> None:
    """Cancel the job if it is not done, and delete everything stored for it."""
    removed = context.table.remove(job.id)
    if removed is None:
        return
    # A worker that runs it finds its claim gone at the next heartbeat, and cleans up behind itself.
    context.discard(source_key(removed.id))
    if removed.result is not None:
        context.discard(removed.result.bitstream_key)
