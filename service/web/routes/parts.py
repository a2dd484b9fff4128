"""What the routes work with, made once and handed to each by FastAPI."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import Annotated

from anyio import CapacityLimiter, to_thread
from fastapi import Depends, Request
from fastapi import Path as PathParameter

from service.jobs.job import Job, is_job_id
from service.jobs.sql import JobTable
from service.keys import KeyRing
from service.settings import Settings
from service.storage.files import Storage
from service.web.guards.gate import Caller
from service.web.guards.metrics import Metrics
from service.web.guards.problems import ProblemError
from service.web.guards.shares import Shares
from service.web.guards.tasks import ClientTasks
from service.web.guards.turns import Turns
from service.web.routes.decoding import PictureCache
from service.web.submitting.bodies import refuse_body

PROBE_THREADS = 4
JobId = Annotated[str, PathParameter(description="32 hexadecimal digits", examples=["0123456789abcdef" * 2])]


@dataclass(frozen=True)
class Parts:
    """The pieces of the running service.

    work: tasks of the sandbox; accepting: turns in which an upload is held in memory, which bounds what all of them
    take together; streams: of events; outflow: bytes that clients have yet to take; stopping: set when the service is
    to stop; watching: threads of probes, which must not queue behind work.
    """

    settings: Settings
    table: JobTable
    storage: Storage
    work: ClientTasks
    pictures: PictureCache
    accepting: Turns
    streams: Shares
    outflow: Shares
    stopping: asyncio.Event
    keys: KeyRing
    metrics: Metrics
    watching: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(PROBE_THREADS))


def _parts(request: Request) -> Parts:
    parts: Parts = request.app.state.parts
    return parts


def no_such_job() -> ProblemError:
    """The answer to an id without a job, well formed or not."""
    return ProblemError(404, "there is no such job")


def _caller(request: Request) -> Caller:
    caller: Caller = request.state.caller
    return caller


def known_query(request: Request) -> None:
    """A misspelt parameter would be ignored, and the answer kept for long. Raises ProblemError 422."""
    route = request.scope["route"]
    if route.path.endswith("/encode"):  # which have their fields there, and say which they are
        return
    operation = request.app.openapi()["paths"].get(route.path, {}).get(request.method.lower(), {})
    known = {parameter["name"] for parameter in operation.get("parameters", []) if parameter["in"] == "query"}
    for name in request.query_params:
        if name not in known:
            takes = f"it takes {', '.join(sorted(known))}" if known else "it takes none"
            raise ProblemError(422, f"unknown query parameter {name!r}; {takes}")
        if len(request.query_params.getlist(name)) > 1:
            raise ProblemError(422, f"the query parameter {name} is given twice")


async def no_stray_body(request: Request) -> None:
    """Fields in a body that is not read would be ignored. Raises ProblemError 422."""
    operation = request.app.openapi()["paths"].get(request.scope["route"].path, {}).get(request.method.lower(), {})
    if request.method != "GET" and "requestBody" not in operation:
        await refuse_body(request, ProblemError(422, "this request takes no body; its parameters are in the query"))


UseParts = Annotated[Parts, Depends(_parts)]
UseCaller = Annotated[Caller, Depends(_caller)]


async def _known_job(job_id: JobId, parts: UseParts, caller: UseCaller) -> Job:
    """The job, if the caller may know of it; a foreign one looks the same as none."""
    if not is_job_id(job_id) or caller.linked_job not in (None, job_id):
        raise no_such_job()
    job = await to_thread.run_sync(parts.table.get, job_id, caller.owner)
    if job is None:
        raise no_such_job()
    return job


KnownJob = Annotated[Job, Depends(_known_job)]
