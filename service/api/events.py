"""A job as a stream of server-sent events."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator

from anyio import to_thread
from fastapi.sse import ServerSentEvent

from service.api import models
from service.api.context import Context, KnownJob, UseContext
from service.jobs.job import FINAL_STATES, Job, JobTableError

log = logging.getLogger(__name__)

POLL_S = 0.5  # workers write progress down as often


async def one_stream(context: UseContext) -> AsyncIterator[None]:
    """One of the places for streams, until the stream ends. Raises ProblemError 503."""
    with context.streams.one():
        yield


async def events(job: KnownJob, context: UseContext) -> AsyncIterator[ServerSentEvent]:
    """Server-sent events: "state" with the job whenever it changes, "trace" with new points and the progress, and
    finally "done" or "failed" with the job, or "removed".

    Every stream starts from the beginning, so after a broken connection simply open a new one. A new attempt starts
    a new trace.
    """
    try:
        async for event in _story(job, context):
            yield event
    except JobTableError as error:
        log.error("an event stream ended early: %s", error)


async def _story(job: Job, context: Context) -> AsyncIterator[ServerSentEvent]:
    last: models.JobSummary | None = None
    attempt, sent, progress = 0, 0, 0.0
    while True:
        summary = models.summary(job, context.settings)
        if summary != last:
            yield ServerSentEvent(event="state", data=summary)
            last = summary
        if job.attempt != attempt:
            attempt, sent = job.attempt, 0
        points = await to_thread.run_sync(context.table.trace, job.id, sent)
        if points:
            sent += len(points)
            progress = max(progress, models.progress(points))
            yield ServerSentEvent(event="trace", data=models.new_points(points, progress))
        if job.state in FINAL_STATES:
            yield ServerSentEvent(event=job.state, data=summary)
            return
        await asyncio.sleep(POLL_S)
        if context.stopping():
            return
        seen = await to_thread.run_sync(context.table.get, job.id)
        if seen is None:
            yield ServerSentEvent(event="removed", data={})
            return
        job = seen
