"""Handlers that return pictures, bitstreams, previews, and files of other codecs at the same size."""

from __future__ import annotations

import hashlib
import logging
import math
import time
from collections.abc import Mapping
from typing import Annotated, BinaryIO

from fastapi import Query, Response
from pydantic import Field

from service.api import requests
from service.api.context import Call, Context, JobId, UseCall
from service.api.jobs import known_job, no_such_job
from service.api.problems import RETRYABLE, ProblemError
from service.api.sending import FileResponse, cache_headers, cached_picture, not_modified
from service.errors import JobTableError
from service.jobs.job import FINAL_STATES, Job, JsonObject
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


class PreviewQuery(requests.Parameters):
    """Query parameters of a preview."""

    bytes: int = Field(
        default=200,
        ge=MIN_PREVIEW_BYTES,
        le=MAX_PREVIEW_BYTES,
        description="of the preview; its text has 4 characters for 3 bytes",
    )


async def picture(call: UseCall, job_id: JobId, kind: PictureFormat, query: PictureQuery) -> Response:
    """Return the decoded picture, whole or in part."""
    return await _picture_response(call, await known_job(call, job_id), kind, query)


async def picture_as_accepted(call: UseCall, job_id: JobId, query: PictureQuery) -> Response:
    """Return the decoded picture in the format that the Accept header prefers; PNG if it has no preference."""
    job = await known_job(call, job_id)
    answer = await _picture_response(call, job, requests.accepted_format(call.request), query)
    answer.headers.update(requests.VARIES)
    return answer


async def picture_of_body_as(call: UseCall, kind: PictureFormat, query: PictureQuery) -> Response:
    """Decode the bitstream in the body. Nothing is stored."""
    async with requests.body_as_file(call.request) as upload:
        drawing = call.context.tasks.draw(call.caller.client, upload.file, query, kind, max_gaussians=MAX_GAUSSIANS)
        file = await requests.while_client_waits(call.request, drawing)
    return FileResponse(call, file, requests.NEVER_STORED, MEDIA_TYPES[kind])


async def picture_of_body(call: UseCall, query: PictureQuery) -> Response:
    """Decode the bitstream in the body to the format that the Accept header prefers. Nothing is stored."""
    answer = await picture_of_body_as(call, requests.accepted_format(call.request), query)
    answer.headers.update(requests.VARIES)
    return answer


async def bitstream(call: UseCall, job_id: JobId) -> Response:
    """Return the .sg file."""
    return await _bitstream_response(call, await known_job(call, job_id))


async def preview(call: UseCall, response: Response, query: Annotated[PreviewQuery, Query()]) -> PreviewFigures:
    """Make a preview: a text that a page shows until the image has loaded, with the image's size and average colour.

    The body is the image. The answer comes at once, without a job, within the limits of decodes. Nothing is stored.
    """
    if requests.media_type(call.request) == requests.FORM_TYPE:
        raise ProblemError(415, "the body must be the image itself, not a form", headers={"Accept": "image/*"})
    response.headers.update(requests.NEVER_STORED)
    async with requests.body_as_file(call.request) as image:
        making = call.context.tasks.preview(call.caller.client, image, query.bytes)
        return await requests.while_client_waits(call.request, making)


async def comparison(call: UseCall, job_id: JobId, kind: ComparisonFormat) -> Response:
    """Return the job's image as a JPEG, WebP or AVIF of the same size as its bitstream, or up to 3 % smaller.

    If no quality setting gives such a file, the next larger one. For a screenshot or a drawing, WebP is lossless if
    that is no larger, and AVIF is 4:4:4. 422 beyond 3 megapixels, except for a lossless WebP. 410 once the image has
    been deleted.
    """
    context, job = call.context, await known_job(call, job_id)
    figures, pixels = _figures_of(job), job.image.width * job.image.height
    if pixels > MAX_COMPARED_PIXELS and (kind, figures.get("better")) != ("webp", "webp"):
        detail = f"the picture has more than {MAX_COMPARED_PIXELS:,} pixels, too many to compare with {kind}"
        raise ProblemError(422, detail)
    if max(job.image.width, job.image.height) > (limit := WRITERS[kind].max_side):
        raise ProblemError(422, f"the picture has more than {limit:,} pixels per side, too many for {kind}")
    until = (job.finished_at or 0.0) + context.settings.source_retention_s
    if time.time() >= until:  # also refuses a cached file
        raise _image_deleted()
    headers = cache_headers(call, job, f'"{job.id}-comparison.{kind}"', until)

    async def encode() -> bytes:
        with await context.store(_open_image, context, job.id) as image:
            return await context.tasks.compare(call.caller.client, image, kind, int(figures["bytes"]), pixels)

    return await cached_picture(call, headers, kind, encode)


def _open_image(context: Context, job_id: str) -> BinaryIO:
    try:
        return context.storage.open(source_key(job_id))
    except FileNotFoundError:
        raise _image_deleted() from None


def _image_deleted() -> ProblemError:
    return ProblemError(410, "the image of this job has been deleted; send it again")


async def file_of_ended(
    call: Call, job: Job, kind: PictureFormat | None, headers: Mapping[str, str]
) -> Response | None:
    """Return the picture or the bitstream of a job, for a client that waited for it; None if it cannot be had now.

    An error that passes, such as a busy sandbox, is no answer: the client would submit the image again. headers: of any
    answer. Raises ProblemError, of a job that failed too.
    """
    if job.state not in FINAL_STATES:
        return None
    try:
        if job.error is not None:
            status = 422 if job.error.code == "refused" else 500
            raise ProblemError(status, job.error.detail, code=job.error.code, id=job.id)
        if kind is None:
            answer = await _bitstream_response(call, job)
        else:
            answer = await _picture_response(call, job, kind, PictureOptions())
    except ProblemError as problem:
        if problem.status in RETRYABLE:
            return None
        problem.headers.update(headers)
        raise
    except (JobTableError, OSError):
        return None
    answer.headers.update({**headers, **requests.VARIES})
    return answer


async def _picture_response(call: Call, job: Job, kind: PictureFormat, options: PictureOptions) -> Response:
    """Answer with a picture of a finished job."""
    context, figures = call.context, _figures_of(job)
    size = (int(figures["width"]), int(figures["height"]))
    drawing = Drawing.from_options(options, kind, size, context.settings.max_pixels)
    pixels = math.prod(drawing.view.size(*size))

    async def draw() -> bytes:
        with await context.store(_open_bitstream, context, job, int(figures["bytes"])) as file:
            try:
                return await context.tasks.draw(call.caller.client, file, options, kind, max_pixels=pixels)
            except RefusedError as error:
                if error.kind is BitstreamError:
                    raise _damaged(job, error) from error
                raise

    headers = cache_headers(call, job, drawing.etag(job.sha256))
    return await cached_picture(call, headers, kind, draw)


async def _bitstream_response(call: Call, job: Job) -> Response:
    """Answer with the .sg file of a finished job."""
    context, figures = call.context, _figures_of(job)
    headers = cache_headers(call, job, f'"{job.sha256[:32]}"')
    headers["Content-Disposition"] = f'attachment; filename="{job.id}.sg"'
    if (answer := not_modified(call.request, headers)) is not None:
        return answer
    with await context.store(_open_bitstream, context, job, int(figures["bytes"])) as file:
        data = await context.store(file.read)
    return FileResponse(call, data, headers, requests.BITSTREAM_TYPE)


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
