"""Handlers that accept new jobs, and may wait to answer with the finished file."""

from __future__ import annotations

import errno
import hashlib
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Request, Response
from fastapi.responses import JSONResponse
from starlette.datastructures import UploadFile

from service.api import models
from service.api.context import Context, UseCaller, UseContext
from service.api.jobs import job_within
from service.api.options import OPTION_SCHEMAS, EncodeOptions, read_options
from service.api.pictures import bitstream, picture
from service.api.problems import RETRYABLE, ProblemError
from service.api.requests import (
    FORM_TYPE,
    IMAGE_FIELD,
    NEVER_STORED,
    VARIES,
    accepted_format,
    idempotency_key,
    image_and_fields,
    wanted_wait_s,
    wants_picture,
)
from service.errors import JobTableError, KeyReusedError, LimitError
from service.jobs.job import Job, NewJob, SourceImage, new_job_id
from service.pictures import PictureOptions
from service.storage.files import source_key

BINARY: dict[str, Any] = {"type": "string", "format": "binary"}
FORM: dict[str, Any] = {
    "type": "object",
    "additionalProperties": False,
    "required": [IMAGE_FIELD],
    "properties": {IMAGE_FIELD: BINARY, **OPTION_SCHEMAS},
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
    "content": {FORM_TYPE: {"schema": FORM}, "image/*": {"schema": BINARY}},
}
WaitSeconds = Annotated[int, Depends(wanted_wait_s)]
IdempotencyKey = Annotated[str | None, Depends(idempotency_key)]


@dataclass(frozen=True)
class _EncodeRequest:
    """A client's request, independent of settings. image: identifies the image."""

    owner: str | None
    key: str | None
    options: EncodeOptions
    image: str

    @property
    def fingerprint(self) -> str:
        """Digest of the request."""
        words = f"{self.options.model_dump_json(exclude_unset=True)} {self.image}"
        return hashlib.sha256(words.encode()).hexdigest()


async def encode(
    request: Request, context: UseContext, caller: UseCaller, wait_s: WaitSeconds, key: IdempotencyKey
) -> Response:
    """Submit an image for encoding, with at most one budget.

    With `wait`, the response is the finished file (or the decoded picture, if the Accept header asks for one) when the
    job is done in time. If it fails in that time, 422 if the codec refused the image, else 500. Otherwise 202 and the
    job as JSON.
    """
    await context.read(context.table.check_queue, caller.owner, key)  # before the body is read
    async with image_and_fields(request) as (file, fields):
        image = "" if key is None else await _digest(file, context)
        wanted = _EncodeRequest(caller.owner, key, read_options(fields), image)
        job = await _first(wanted, context)
        if job is None:
            header = await context.tasks.read_header(caller.client, file)
            async with context.accepting.turn(caller.client):
                await file.seek(0)
                job = await context.store(_accept, context, wanted, header, await file.read())
    return await _answer(request, context, job, wait_s)


async def _digest(file: UploadFile, context: Context) -> str:
    await file.seek(0)
    return (await context.store(hashlib.file_digest, file.file, "sha256")).hexdigest()


async def _first(wanted: _EncodeRequest, context: Context) -> Job | None:
    """Return the job that the same request has already made. Raises KeyReusedError.

    Checked before anything else: what would be refused now may have been accepted then.
    """
    if wanted.key is None:
        return None
    return await context.read(context.table.first, wanted.owner, wanted.key, wanted.fingerprint)


def _accept(context: Context, wanted: _EncodeRequest, header: SourceImage, image: bytes) -> Job:
    """Store the image, then insert the job. Only then may the client get an answer."""
    request = wanted.options.request(header, context.settings.max_time_limit_s)
    priority = wanted.options.priority
    new = NewJob(new_job_id(), request, header, wanted.fingerprint, wanted.key, wanted.owner, priority)
    free_bytes = context.storage.free_bytes()  # a large upload is a temporary file there, and so counted already
    if free_bytes is not None and free_bytes < context.settings.min_free_bytes:
        raise OSError(errno.ENOSPC, f"No space left for new jobs: {free_bytes} bytes are free")
    context.storage.put(source_key(new.id), image)
    try:  # after an error of the table, the image stays for the sweep: the row may have been written
        job, is_new = context.table.submit(new)
    except (LimitError, KeyReusedError):
        context.discard(source_key(new.id))
        raise
    if is_new:
        context.metrics.accepted.inc()
    else:
        context.discard(source_key(new.id))
    return job


async def _answer(request: Request, context: Context, job: Job, wait_s: int) -> Response:
    """Answer with the finished file if the client waits and the job is done in time, else with the accepted job.

    An error that passes, such as a busy sandbox, is not an answer here: the client would submit the image again.
    """
    view = models.accepted(job, context.settings)
    headers = {"Location": view.status_url, **NEVER_STORED}
    file = None
    if wait_s and not context.waits.is_full(request.state.caller.client):
        try:
            file = await _file_within(request, context, job, wait_s)
        except ProblemError as problem:
            if problem.status not in RETRYABLE:
                problem.headers.update(headers)
                raise
        except (JobTableError, OSError):
            pass
    if file is None:
        return JSONResponse(view.model_dump(), 202, headers)
    file.headers.update({**headers, **VARIES})
    return file


async def _file_within(request: Request, context: Context, job: Job, wait_s: int) -> Response | None:
    """Return the bitstream, or the picture that Accept asks for; None if the job is not done within wait_s seconds.

    Raises ProblemError, JobTableError, OSError.
    """
    ended = await job_within(request, job, wait_s, context)
    if ended is None:
        return None
    if ended.error is not None and ended.state == "failed":
        status = 422 if ended.error.code == "refused" else 500
        raise ProblemError(status, ended.error.detail, code=ended.error.code, id=ended.id)
    if wants_picture(request):
        return await picture(ended, accepted_format(request), PictureOptions(), context, request)
    return await bitstream(ended, context, request)
