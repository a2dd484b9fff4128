"""Handlers that return pictures, bitstreams, previews, and files of other codecs at the same size."""

from __future__ import annotations

import hashlib
import logging
import math
import time
from collections.abc import Callable, Coroutine, Mapping
from email.utils import formatdate
from typing import Annotated, Any, BinaryIO

from fastapi import Query, Request, Response
from pydantic import Field

from service.api import requests
from service.api.context import Context, JobId, UseCaller, UseContext, context_of, known_job, no_such_job
from service.api.jobs import expires_at
from service.api.problems import ProblemError
from service.api.sending import FileResponse
from service.jobs.job import Job, JsonObject
from service.pictures import (
    MAX_COMPARED_PIXELS,
    MEDIA_TYPES,
    WRITERS,
    ComparisonFormat,
    Drawing,
    PictureFormat,
    PictureOptions,
)
from service.sandbox.client import RefusedError
from service.sandbox.frames import PreviewFigures
from service.storage.files import bitstream_key, source_key
from sgmethod.errors import BitstreamError

log = logging.getLogger(__name__)

PictureQuery = Annotated[PictureOptions, Query()]

MAX_GAUSSIANS = 1_000_000  # of a posted bitstream, where equal ones take an eighth of a byte each
MIN_PREVIEW_BYTES, MAX_PREVIEW_BYTES = 12, 4096
MAX_CACHED_S = 31_536_000  # a year, the most that RFC 2616 allowed


class PreviewQuery(requests.Parameters):
    """Query parameters of a preview."""

    bytes: int = Field(
        default=200,
        ge=MIN_PREVIEW_BYTES,
        le=MAX_PREVIEW_BYTES,
        description="of the preview; its text has 4 characters for 3 bytes",
    )


async def picture(job_id: JobId, kind: PictureFormat, query: PictureQuery, request: Request) -> Response:
    """Return the decoded picture, whole or in part."""
    return await picture_response(request, await known_job(request, job_id), kind, query)


async def picture_as_accepted(job_id: JobId, query: PictureQuery, request: Request) -> Response:
    """Return the decoded picture in the format that the Accept header prefers; PNG if it has no preference."""
    job = await known_job(request, job_id)
    answer = await picture_response(request, job, requests.accepted_format(request), query)
    answer.headers.update(requests.VARIES)
    return answer


async def picture_of_body_as(kind: PictureFormat, query: PictureQuery, request: Request) -> Response:
    """Decode the bitstream in the body. Nothing is stored."""
    return await _drawn_body(request, kind, query, requests.NEVER_STORED)


async def picture_of_body(query: PictureQuery, request: Request) -> Response:
    """Decode the bitstream in the body to the format that the Accept header prefers. Nothing is stored."""
    kind = requests.accepted_format(request)
    return await _drawn_body(request, kind, query, {**requests.NEVER_STORED, **requests.VARIES})


async def _drawn_body(
    request: Request, kind: PictureFormat, options: PictureOptions, headers: Mapping[str, str]
) -> Response:
    tasks, client = context_of(request).tasks, request.state.caller.client
    async with requests.body_as_file(request) as upload:
        drawing = tasks.draw(client, upload.file, options, kind, max_gaussians=MAX_GAUSSIANS)
        file = await requests.while_client_waits(request, drawing)
    return FileResponse(request, file, headers, MEDIA_TYPES[kind])


async def bitstream(job_id: JobId, request: Request) -> Response:
    """Return the .sg file."""
    return await bitstream_response(request, await known_job(request, job_id))


async def preview(
    request: Request,
    response: Response,
    context: UseContext,
    caller: UseCaller,
    query: Annotated[PreviewQuery, Query()],
) -> PreviewFigures:
    """Make a preview: a text that a page shows until the image has loaded, with the image's size and average colour.

    The body is the image. The answer comes at once, without a job, within the limits of decodes. Nothing is stored.
    """
    if requests.media_type(request) == requests.FORM_TYPE:
        raise ProblemError(415, "the body must be the image itself, not a form", headers={"Accept": "image/*"})
    response.headers.update(requests.NEVER_STORED)
    async with requests.body_as_file(request) as image:
        return await requests.while_client_waits(request, context.tasks.preview(caller.client, image, query.bytes))


async def comparison(
    job_id: JobId, kind: ComparisonFormat, context: UseContext, caller: UseCaller, request: Request
) -> Response:
    """Return the job's image as a JPEG, WebP or AVIF of the same size as its bitstream, or up to 3 % smaller.

    If no quality setting gives such a file, the next larger one. For a screenshot or a drawing, WebP is lossless if
    that is no larger, and AVIF is 4:4:4. 422 beyond 3 megapixels, except for a lossless WebP. 410 once the image has
    been deleted.
    """
    job = await known_job(request, job_id)
    figures, pixels = _figures_of(job), job.image.width * job.image.height
    if pixels > MAX_COMPARED_PIXELS and (kind, figures.get("better")) != ("webp", "webp"):
        detail = f"the picture has more than {MAX_COMPARED_PIXELS:,} pixels, too many to compare with {kind}"
        raise ProblemError(422, detail)
    if max(job.image.width, job.image.height) > (limit := WRITERS[kind].max_side):
        raise ProblemError(422, f"the picture has more than {limit:,} pixels per side, too many for {kind}")
    until = (job.finished_at or 0.0) + context.settings.source_retention_s
    if time.time() >= until:  # also refuses a cached file
        raise _image_deleted()
    headers = {"ETag": f'"{job.id}-comparison.{kind}"', **_cache_headers(request, job, until)}

    async def encode() -> bytes:
        with await context.store(_open_image, context, job.id) as image:
            return await context.tasks.compare(caller.client, image, kind, int(figures["bytes"]), pixels)

    return await _cached_response(request, headers, kind, encode)


def _open_image(context: Context, job_id: str) -> BinaryIO:
    try:
        return context.storage.open(source_key(job_id))
    except FileNotFoundError:
        raise _image_deleted() from None


def _image_deleted() -> ProblemError:
    return ProblemError(410, "the image of this job has been deleted; send it again")


async def picture_response(request: Request, job: Job, kind: PictureFormat, options: PictureOptions) -> Response:
    """Answer with a picture of a finished job."""
    context, figures = context_of(request), _figures_of(job)
    size = (int(figures["width"]), int(figures["height"]))
    drawing = Drawing.from_options(options, kind, size, context.settings.max_pixels)
    pixels = math.prod(drawing.view.size(*size))

    async def draw() -> bytes:
        with await context.store(_open_bitstream, context, job, int(figures["bytes"])) as file:
            try:
                return await context.tasks.draw(request.state.caller.client, file, options, kind, max_pixels=pixels)
            except RefusedError as error:
                if error.kind is BitstreamError:
                    raise _damaged(job, error) from error
                raise

    headers = {"ETag": drawing.etag(job.sha256), **_cache_headers(request, job)}
    return await _cached_response(request, headers, kind, draw)


async def bitstream_response(request: Request, job: Job) -> Response:
    """Answer with the .sg file of a finished job."""
    context, figures = context_of(request), _figures_of(job)
    headers = {
        "ETag": f'"{job.sha256[:32]}"',
        **_cache_headers(request, job),
        "Content-Disposition": f'attachment; filename="{job.id}.sg"',
    }
    if (answer := _not_modified(request, headers)) is not None:
        return answer
    with await context.store(_open_bitstream, context, job, int(figures["bytes"])) as file:
        data = await context.store(file.read)
    return FileResponse(request, data, headers, requests.BITSTREAM_TYPE)


async def _cached_response(
    request: Request, headers: dict[str, str], kind: PictureFormat, make: Callable[[], Coroutine[Any, Any, bytes]]
) -> Response:
    """Answer with the picture that the ETag names: 304 if the client has it; else from the cache, or from `make`."""
    if (answer := _not_modified(request, headers)) is not None:
        return answer
    context = context_of(request)
    file = context.pictures.get(headers["ETag"])
    if file is None:
        file = await requests.while_client_waits(request, make())
        context.pictures.put(headers["ETag"], file)
    return FileResponse(request, file, headers, MEDIA_TYPES[kind])


def _not_modified(request: Request, headers: Mapping[str, str]) -> Response | None:
    """Return 304 if the client has the file with this ETag (RFC 9110, 13.1.2)."""
    given = requests.header_line(request.headers, "if-none-match") if request.method == "GET" else None
    known = [tag.strip().removeprefix("W/") for tag in (given or "").split(",")]
    if "*" not in known and headers["ETag"] not in known:
        return None
    kept = {name: value for name, value in headers.items() if name != "Content-Disposition"}
    return Response(status_code=304, headers=kept)


def _cache_headers(request: Request, job: Job, image_until: float | None = None) -> dict[str, str]:
    """Return the caching headers of a file.

    A response to a link is cached no longer than the link is valid, and a file made from the image no longer than until
    image_until.
    """
    ends = [end for end in (request.state.caller.link_expires, image_until) if end is not None]
    max_age_s = min([MAX_CACHED_S, *(max(0, int(end - time.time())) for end in ends)])
    # Private, because the URL contains a secret id, which shared caches should not store.
    headers = {"Cache-Control": f"private, max-age={max_age_s}, immutable"}
    if (removed := expires_at(job, context_of(request).settings)) is not None:
        ends.append(removed)
    return {**headers, "Expires": formatdate(min(ends), usegmt=True)} if ends else headers


def _figures_of(job: Job) -> JsonObject:
    """Return the figures of a finished job. Raises ProblemError 409 with the state of any other."""
    if job.result is not None:
        return job.result
    detail = f"the job is {job.state}"
    if job.error is not None:
        detail += f": {job.error.detail}"
    raise ProblemError(409, detail, state=job.state)


def _open_bitstream(context: Context, job: Job, size_bytes: int) -> BinaryIO:
    """Open the bitstream of a finished job.

    Raises ProblemError 404 if the job was removed meanwhile, 500 if the bitstream is missing or damaged.
    """
    try:
        file = context.storage.open(bitstream_key(job.id, job.attempt))
    except FileNotFoundError as error:
        if context.table.get(job.id) is None:
            raise no_such_job() from None
        raise _damaged(job, error) from error
    # Clients keep an answer for a year, and a part of a damaged file may be drawn.
    if hashlib.file_digest(file, "sha256").hexdigest() != job.sha256:  # type: ignore[arg-type]
        size = file.tell()
        file.close()
        raise _damaged(job, f"{size} bytes are not the {size_bytes} that were stored")
    file.seek(0)
    return file


def _damaged(job: Job, error: Exception | str) -> ProblemError:
    log.error("job %s: its bitstream is damaged: %s", job.id, error)
    return ProblemError(500, "the bitstream of this job is missing or damaged")
