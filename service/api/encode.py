"""Handlers that accept new jobs, and may wait to answer with the finished file."""

from __future__ import annotations

import asyncio
import errno
import hashlib
import time
from contextlib import suppress
from mmap import ACCESS_READ, mmap
from typing import Any, BinaryIO

from fastapi import Request, Response
from fastapi.responses import JSONResponse

from service.api import requests
from service.api.context import Context, UseCaller, UseContext
from service.api.decode import bitstream_response, picture_response
from service.api.jobs import accepted
from service.api.metrics import WAITED_S
from service.api.options import OPTION_SCHEMAS, EncodeQuery, queries, read_options
from service.api.problems import RETRYABLE, ProblemError
from service.errors import JobTableError, KeyReusedError, LimitError
from service.jobs.job import FINAL_STATES, Job, NewJob, new_job_id
from service.jobs.table import JobTable
from service.pictures import PictureOptions
from service.storage.files import source_key

BINARY: dict[str, Any] = {"type": "string", "format": "binary"}
FORM: dict[str, Any] = {
    "type": "object",
    "additionalProperties": False,
    "required": [requests.IMAGE_FIELD],
    "properties": {requests.IMAGE_FIELD: BINARY, **OPTION_SCHEMAS},
}
PARAMETERS: list[dict[str, Any]] = [
    {
        "name": "Idempotency-Key",
        "in": "header",
        "description": "repeating a request with the same key returns its first job; another request gets 422",
        "schema": {"type": "string", "maxLength": 255, "pattern": "^[!-~]+$"},
    },
    *({"name": name, "in": "query", "schema": schema} for name, schema in OPTION_SCHEMAS.items()),
]
ENCODE_BODY: dict[str, Any] = {
    "required": True,
    "description": "a form with the image and the options, or the image itself with the options in the query",
    "content": {requests.FORM_TYPE: {"schema": FORM}, "image/*": {"schema": BINARY}},
}
FIRST_POLL_S, POLL_S = 0.05, 0.2  # shorter at first, for small pictures


async def encode(request: Request, context: UseContext, caller: UseCaller, wait: requests.Wait = 0) -> Response:
    """Submit an image for encoding, with at most one budget.

    With `wait`, the response is the finished file (or the decoded picture, if the Accept header asks for one) when the
    job is done in time. If it fails in that time, 422 if the codec refused the image, else 500. Otherwise 202 and the
    job as JSON.
    """
    wait_s, key = requests.wanted_wait_s(request, wait), requests.idempotency_key(request)
    await context.read(context.table.check_queue, caller.client, caller.owner, key)  # before the body is read
    async with requests.image_and_fields(request) as (image, fields):
        deadline = time.monotonic() + wait_s  # a proxy's, too, counts from here
        query = read_options(fields)
        # First, since what would be refused now may have been accepted then.
        job, fingerprint = await context.read(_earlier, context.table, query, image.file, caller.owner, key)
        if job is None:
            header = await context.tasks.read_header(caller.client, image)
            wanted = query.request(header, context.settings.max_time_limit_s)
            new = NewJob(new_job_id(), wanted, header, fingerprint, key, caller.owner, query.priority, caller.client)
            job = await context.store(_accept, context, new, image.file)
    if wait_s:
        job = await _waited(request, context, job, deadline)
    return await _answer(request, context, job, wants_file=wait_s > 0)


def _earlier(
    table: JobTable, query: EncodeQuery, image: BinaryIO, owner: str | None, key: str | None
) -> tuple[Job | None, str]:
    """Return the job that a request with this key made before, and a digest of this one, independent of settings."""
    if key is None:
        return None, ""
    image.seek(0)
    digest = hashlib.file_digest(image, "sha256").hexdigest()  # type: ignore[arg-type]
    fingerprint = hashlib.sha256(queries.dump_json(query, exclude_defaults=True) + f" {digest}".encode()).hexdigest()
    return table.first(owner, key, fingerprint), fingerprint


def _accept(context: Context, new: NewJob, image: BinaryIO) -> Job:
    """Store the image, then insert the job. Only then may the client get an answer."""
    free_bytes = context.storage.free_bytes()  # a large upload is a temporary file there, and so counted already
    if free_bytes is not None and free_bytes < context.settings.min_free_bytes:
        raise OSError(errno.ENOSPC, f"No space left for new jobs: {free_bytes} bytes are free")
    # Mapped, since the images of many requests at once would fill the memory.
    context.storage.put(source_key(new.id), memoryview(mmap(image.fileno(), 0, access=ACCESS_READ)))
    try:  # after an error of the table, the image stays for the sweep: the row may have been written
        job, is_new = context.table.submit(new)
    except (LimitError, KeyReusedError):
        context.discard(source_key(new.id))
        raise
    if not is_new:
        context.discard(source_key(new.id))
    return job


async def _waited(request: Request, context: Context, job: Job, deadline: float) -> Job:
    """Return the job once it has ended, or as it is at the deadline, and where no place to wait is free."""
    began, client = time.monotonic(), request.state.caller.client
    if not context.waits.is_full_for(client):
        with context.waits.hold(client), suppress(JobTableError, OSError):
            try:
                job = await requests.while_client_waits(request, _ended(context, job, deadline))
            finally:
                setattr(request.state, WAITED_S, time.monotonic() - began)
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


async def _answer(request: Request, context: Context, job: Job, *, wants_file: bool) -> Response:
    """Answer with the file of a finished job, if the client waited for it, else with the accepted job.

    An error that passes, such as a busy sandbox, is not an answer here: the client would submit the image again.
    """
    view = accepted(job, context.settings)
    headers = {"Location": view.status_url, **requests.NEVER_STORED}
    answer: Response = JSONResponse(view.model_dump(), 202)
    if wants_file and job.state in FINAL_STATES:
        try:
            answer = await _file_of(request, job)
            headers |= requests.VARIES
        except ProblemError as problem:
            if problem.status not in RETRYABLE:
                problem.headers.update(headers)
                raise
        except (JobTableError, OSError):
            pass
    answer.headers.update(headers)
    return answer


async def _file_of(request: Request, job: Job) -> Response:
    """Return the bitstream, or the picture that Accept asks for. Raises ProblemError, JobTableError, OSError."""
    if job.error is not None:
        status = 422 if job.error.code == "refused" else 500
        raise ProblemError(status, job.error.detail, code=job.error.code, id=job.id)
    if requests.wants_picture(request):
        return await picture_response(request, job, requests.accepted_format(request), PictureOptions())
    return await bitstream_response(request, job)
