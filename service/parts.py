"""What the routes work with, made once and handed to each by FastAPI."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from anyio import CapacityLimiter, to_thread
from fastapi import Depends, Request

from service.decoding import PictureCache, PictureDecoder
from service.jobs import Job, JobBackend, is_job_id
from service.problems import ProblemError
from service.settings import Settings
from service.storage import Storage


@dataclass(frozen=True)
class Parts:
    """The pieces of the running service.

    accepting: taken while an upload is held in memory, which bounds what all of them take together.
    """

    settings: Settings
    backend: JobBackend
    storage: Storage
    decoder: PictureDecoder
    pictures: PictureCache
    accepting: CapacityLimiter


def _parts(request: Request) -> Parts:
    parts: Parts = request.app.state.parts
    return parts


def no_such_job() -> ProblemError:
    """The answer to an id without a job, well formed or not."""
    return ProblemError(404, "there is no such job")


async def _known_job(job_id: str, parts: Annotated[Parts, Depends(_parts)]) -> Job:
    if not is_job_id(job_id):
        raise no_such_job()
    job = await to_thread.run_sync(parts.backend.get, job_id)
    if job is None:
        raise no_such_job()
    return job


UseParts = Annotated[Parts, Depends(_parts)]
KnownJob = Annotated[Job, Depends(_known_job)]
