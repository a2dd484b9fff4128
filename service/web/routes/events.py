"""A job as a stream of server-sent events."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator

from anyio import to_thread
from fastapi import APIRouter, Depends
from fastapi.sse import EventSourceResponse, ServerSentEvent

from service.jobs.job import FINAL_STATES, Job
from service.jobs.table import JobTableError
from service.web.guards.problems import problems
from service.web.routes import answers
from service.web.routes.answers import curl
from service.web.routes.parts import KnownJob, Parts, UseParts

log = logging.getLogger(__name__)
router = APIRouter()

POLL_S = 0.5  # workers write progress down as often


async def _place(parts: UseParts) -> AsyncIterator[None]:
    """One of the places for streams, until the stream ends. Raises ProblemError 503."""
    with parts.streams.one():
        yield


@router.get(
    "/jobs/{job_id}/events",
    response_class=EventSourceResponse,
    responses=problems(404, 503),
    summary="Follow a job",
    dependencies=[Depends(_place)],  # which come first: too many streams are refused before a job is looked up
    openapi_extra=curl("-N HOST/jobs/ID/events"),
)
async def events(job: KnownJob, parts: UseParts) -> AsyncIterator[ServerSentEvent]:
    """Server-sent events: "state" with the job whenever it changes, "trace" with new points and the progress, and
    finally "done" or "failed" with the job, or "removed".

    Every stream starts from the beginning, so after a broken connection simply open a new one. A new attempt starts
    a new trace.
    """
    try:
        async for event in _story(job, parts):
            yield event
    except JobTableError as error:
        log.error("an event stream ended early: %s", error)


async def _story(job: Job, parts: Parts) -> AsyncIterator[ServerSentEvent]:
    last: answers.JobSummary | None = None
    attempt, sent, progress = 0, 0, 0.0
    while True:
        summary = answers.summary(job, parts.settings)
        if summary != last:
            yield ServerSentEvent(event="state", data=summary)
            last = summary
        if job.attempt != attempt:
            attempt, sent = job.attempt, 0
        points = await to_thread.run_sync(parts.table.trace, job.id, sent)
        if points:
            sent += len(points)
            progress = max(progress, answers.progress(points))
            yield ServerSentEvent(event="trace", data=answers.new_points(points, progress))
        if job.state in FINAL_STATES:
            yield ServerSentEvent(event=job.state, data=summary)
            return
        await asyncio.sleep(POLL_S)
        if parts.stopping():
            return
        seen = await to_thread.run_sync(parts.table.get, job.id)
        if seen is None:
            yield ServerSentEvent(event="removed", data={})
            return
        job = seen
