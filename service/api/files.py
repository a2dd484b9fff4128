"""Answers with the files of jobs: pictures, bitstreams, and how long clients may cache them."""

from __future__ import annotations

import hashlib
import logging
import math
import time
from collections.abc import Callable, Coroutine, Mapping
from email.utils import formatdate
from typing import Any, BinaryIO

from fastapi import Request, Response

from service.api import models
from service.api.context import Context, context_of, no_such_job
from service.api.problems import ProblemError
from service.api.requests import BITSTREAM_TYPE, header_line, while_client_waits
from service.jobs.job import EncodeResult, Job
from service.pictures import MEDIA_TYPES, Drawing, PictureFormat, PictureOptions
from service.sandbox.client import RefusedError
from sgmethod.errors import BitstreamError

log = logging.getLogger(__name__)

MAX_CACHED_S = 31_536_000  # a year, the most that RFC 2616 allowed


async def picture_response(request: Request, job: Job, kind: PictureFormat, options: PictureOptions) -> Response:
    """Answer with a picture of a finished job."""
    context, result = context_of(request), result_of(job)
    size = (int(result.stats["width"]), int(result.stats["height"]))
    drawing = Drawing.from_options(options, kind, size, context.settings.max_pixels)
    pixels = math.prod(drawing.view.size(*size))

    async def draw() -> bytes:
        with await context.store(_open_bitstream, context, job, result) as file:
            try:
                return await context.tasks.draw(request.state.caller.client, file, options, kind, max_pixels=pixels)
            except RefusedError as error:
                if error.kind is BitstreamError:
                    raise _damaged(job, error) from error
                raise

    headers = {"ETag": drawing.etag(result.sha256), **cache_headers(request, job)}
    return await cached_response(request, headers, kind, draw)


async def bitstream_response(request: Request, job: Job) -> Response:
    """Answer with the .sg file of a finished job."""
    context, result = context_of(request), result_of(job)
    headers = {
        "ETag": f'"{result.sha256[:32]}"',
        **cache_headers(request, job),
        "Content-Disposition": f'attachment; filename="{job.id}.sg"',
    }
    if (answer := not_modified(request, headers)) is not None:
        return answer
    data = await stored_bitstream(context, job, result)
    return Response(data, headers=headers, media_type=BITSTREAM_TYPE)


async def cached_response(
    request: Request, headers: dict[str, str], kind: PictureFormat, make: Callable[[], Coroutine[Any, Any, bytes]]
) -> Response:
    """Answer with the picture that the ETag names: 304 if the client has it; else from the cache, or from `make`."""
    if (answer := not_modified(request, headers)) is not None:
        return answer
    context = context_of(request)
    file = context.pictures.get(headers["ETag"])
    context.metrics.cache.labels("no" if file is None else "yes").inc()
    if file is None:
        file = await while_client_waits(request, make())
        context.pictures.put(headers["ETag"], file)
    return Response(file, headers=headers, media_type=MEDIA_TYPES[kind])


def not_modified(request: Request, headers: Mapping[str, str]) -> Response | None:
    """Return 304 if the client has the file with this ETag (RFC 9110, 13.1.2)."""
    given = header_line(request.headers, "if-none-match") if request.method == "GET" else None
    known = [tag.strip().removeprefix("W/") for tag in (given or "").split(",")]
    if "*" not in known and headers["ETag"] not in known:
        return None
    kept = {name: value for name, value in headers.items() if name != "Content-Disposition"}
    return Response(status_code=304, headers=kept)


def cache_headers(request: Request, job: Job, image_until: float | None = None) -> dict[str, str]:
    """Return the caching headers of a file.

    A response to a link is cached no longer than the link is valid, and a file made from the image no longer than until
    image_until.
    """
    ends = [end for end in (request.state.caller.link_expires, image_until) if end is not None]
    max_age_s = min([MAX_CACHED_S, *(max(0, int(end - time.time())) for end in ends)])
    # Private, because the URL contains a secret id, which shared caches should not store.
    headers = {"Cache-Control": f"private, max-age={max_age_s}, immutable"}
    if (removed := models.expires_at(job, context_of(request).settings)) is not None:
        ends.append(removed)
    return {**headers, "Expires": formatdate(min(ends), usegmt=True)} if ends else headers


def result_of(job: Job) -> EncodeResult:
    """Return the result of a finished job. Raises ProblemError 409 with the state of any other."""
    if job.result is not None:
        return job.result
    detail = f"the job is {job.state}"
    if job.state == "failed" and job.error is not None:
        detail += f": {job.error.detail}"
    raise ProblemError(409, detail, state=job.state)


async def stored_bitstream(context: Context, job: Job, result: EncodeResult) -> bytes:
    """Return the bitstream of a finished job.

    Raises ProblemError 404 if the job was removed meanwhile, 500 if the bitstream is missing or damaged.
    """
    with await context.store(_open_bitstream, context, job, result) as file:
        return await context.store(file.read)


def _open_bitstream(context: Context, job: Job, result: EncodeResult) -> BinaryIO:
    try:
        file = context.storage.open(result.bitstream_key)
    except FileNotFoundError as error:
        if context.table.get(job.id) is None:
            raise no_such_job() from None
        raise _damaged(job, error) from error
    # Clients keep an answer for a year, and a part of a damaged file may be drawn.
    if hashlib.file_digest(file, "sha256").hexdigest() != result.sha256:  # type: ignore[arg-type]
        size = file.tell()
        file.close()
        raise _damaged(job, f"{size} bytes are not the {result.size_bytes} that were stored")
    file.seek(0)
    return file


def _damaged(job: Job, error: Exception | str) -> ProblemError:
    log.error("job %s: its bitstream is damaged: %s", job.id, error)
    return ProblemError(500, "the bitstream of this job is missing or damaged")
