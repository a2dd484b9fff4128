"""Requests that wait: for the end of a job, or for work that ends when its client has gone."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Coroutine
from typing import Any, TypeVar

from anyio import to_thread
from fastapi import Request
from starlette.requests import ClientDisconnect

from service.api.callers import header_line
from service.api.context import Context
from service.api.problems import ProblemError
from service.api.uploads import WAIT_FIELD
from service.jobs.job import FINAL_STATES, Job

FIRST_POLL_S, POLL_S = 0.05, 0.2  # a small picture takes less than the latter; it is for those who wait for long
MAX_WAIT_S = 50  # proxies give up on an answer that has not begun after 60 s, unless told otherwise
WAIT_PARAMETERS: list[dict[str, Any]] = [
    {
        "name": WAIT_FIELD,
        "in": "query",
        "description": f"seconds to wait for the file; 202 after that, and after {MAX_WAIT_S} seconds at the latest",
        "schema": {"type": "integer", "minimum": 0, "maximum": 999_999},
    },
    {
        "name": "Prefer",
        "in": "header",
        "description": "`wait=30` is the same as the query parameter; what cannot be read is ignored",
        "schema": {"type": "string"},
    },
]

_PREFER = re.compile(r"(?:^|[,;])\s*wait\s*=\s*([0-9]{1,6})\s*(?=[,;]|$)", re.IGNORECASE)
T = TypeVar("T")


def wanted_wait_s(request: Request) -> int:
    """Seconds that the client would wait; 0 unless it says so. Raises ProblemError 422."""
    given = request.query_params.get(WAIT_FIELD)
    if given is not None:
        if not re.fullmatch(r"[0-9]{1,6}", given, re.ASCII):
            raise ProblemError(422, f"{WAIT_FIELD} must be a whole number of seconds (capped at {MAX_WAIT_S})")
        return min(int(given), MAX_WAIT_S)
    preferred = _PREFER.search(header_line(request.headers, "prefer") or "")  # RFC 7240
    return min(int(preferred[1]), MAX_WAIT_S) if preferred else 0


async def job_within(request: Request, job: Job, seconds: int, context: Context) -> Job | None:
    """The job once it has ended, None if it has not in time. Raises ProblemError 409 if it is removed meanwhile."""
    if context.streams.full:  # too many wait already
        return None
    with context.streams.one():
        return await while_client_waits(request, _ended(job, time.monotonic() + seconds, context))


async def _ended(job: Job, deadline: float, context: Context) -> Job | None:
    pause_s = FIRST_POLL_S
    while job.state not in FINAL_STATES:
        pause_s = min(1.1 * pause_s, POLL_S)
        await asyncio.sleep(pause_s)
        if time.monotonic() >= deadline or context.stopping():
            return None
        seen = await to_thread.run_sync(context.table.get, job.id)
        if seen is None:
            raise ProblemError(409, "the job was removed before it was done")
        job = seen
    return job


async def while_client_waits(request: Request, work: Coroutine[Any, Any, T]) -> T:
    """What the work comes to; it is cancelled when the client has gone, and ClientDisconnect raised.

    The body must have been read.
    """
    working = asyncio.create_task(work)
    tasks = working, asyncio.create_task(_gone(request))
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        if working.done():
            return working.result()
        raise ClientDisconnect
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _gone(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass
