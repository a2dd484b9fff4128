"""Handlers that return pictures, bitstreams, previews, and files of other codecs at the same size."""

from __future__ import annotations

import hashlib
import logging
import math
import time
from collections.abc import Callable, Coroutine
from email.utils import formatdate
from typing import Annotated, Any, BinaryIO

from fastapi import Query, Request, Response
from pydantic import Field

from service.api import models
from service.api.context import Context, KnownJob, UseCaller, UseContext, no_such_job
from service.api.problems import ProblemError
from service.api.requests import (
    BITSTREAM_TYPE,
    FORM_TYPE,
    MAX_CACHED_S,
    NEVER_STORED,
    VARIES,
    Parameters,
    accepted_format,
    body_as_file,
    media_type,
    not_modified,
    while_client_waits,
)
from service.jobs.job import EncodeResult, Job
from service.pictures import (
    MAX_SIDES,
    MEDIA_TYPES,
    ComparisonFormat,
    Drawing,
    PictureFormat,
    PictureOptions,
)
from service.sandbox.client import RefusedError
from service.sandbox.frames import PreviewFigures
from service.storage.files import preview_key, source_key
from sgmethod.errors import BitstreamError

log = logging.getLogger(__name__)

MAX_GAUSSIANS = 1_000_000  # of a posted bitstream, where equal ones take an eighth of a byte each
MIN_PREVIEW_BYTES, MAX_PREVIEW_BYTES = 12, 4096


class PreviewQuery(Parameters):
    """Query parameters of a preview."""

    bytes: int = Field(
        default=200,
        ge=MIN_PREVIEW_BYTES,
        le=MAX_PREVIEW_BYTES,
        description="of the preview; its text has 4 characters for 3 bytes",
    )


async def picture(
    job: KnownJob, kind: PictureFormat, query: Annotated[PictureOptions, Query()], context: UseContext, request: Request
) -> Response:
    """Return the decoded picture, whole or in part, as PNG, JPEG, WebP or AVIF."""
    result = _result_of(job)
    size = (int(result.stats["width"]), int(result.stats["height"]))
    drawing = Drawing.from_options(query, kind, size, context.settings.max_pixels)
    pixels = math.prod(drawing.view.size(*size))
    headers = {"ETag": drawing.etag(result.sha256), **_cache_headers(request, job, context)}

    async def draw() -> bytes:
        with await context.store(_open_bitstream, context, job, result) as file:
            try:
                return await context.tasks.draw(request.state.caller.client, file, query, kind, max_pixels=pixels)
            except RefusedError as error:
                if error.kind is BitstreamError:
                    raise _damaged(job, error) from error
                raise

    return await _cached_response(request, context, headers, kind, draw)


async def picture_as_accepted(
    job: KnownJob, query: Annotated[PictureOptions, Query()], context: UseContext, request: Request
) -> Response:
    """Return the decoded picture in the format that the Accept header prefers; PNG if it has no preference."""
    answer = await picture(job, accepted_format(request), query, context, request)
    answer.headers.update(VARIES)
    return answer


async def _cached_response(
    request: Request,
    context: Context,
    headers: dict[str, str],
    kind: PictureFormat,
    make: Callable[[], Coroutine[Any, Any, bytes]],
) -> Response:
    """Answer with the picture file that the ETag among the headers names.

    304 if the client has it; else from the cache, or from `make`.
    """
    if (answer := not_modified(request, headers)) is not None:
        return answer
    file = context.pictures.get(headers["ETag"])
    context.metrics.cache.labels("no" if file is None else "yes").inc()
    if file is None:
        file = await while_client_waits(request, make())
        context.pictures.put(headers["ETag"], file)
    return Response(file, headers=headers, media_type=MEDIA_TYPES[kind])


async def picture_of_body(query: Annotated[PictureOptions, Query()], context: UseContext, request: Request) -> Response:
    """Decode the bitstream in the body to the format that the Accept header prefers. Nothing is stored."""
    answer = await picture_of_body_as(accepted_format(request), query, context, request)
    answer.headers.update(VARIES)
    return answer


async def picture_of_body_as(
    kind: PictureFormat, query: Annotated[PictureOptions, Query()], context: UseContext, request: Request
) -> Response:
    """Decode the bitstream in the body. Nothing is stored."""
    async with body_as_file(request) as upload:
        client = request.state.caller.client
        drawing = context.tasks.draw(client, upload.file, query, kind, max_gaussians=MAX_GAUSSIANS)
        file = await while_client_waits(request, drawing)
    return Response(file, headers=NEVER_STORED, media_type=MEDIA_TYPES[kind])


async def bitstream(job: KnownJob, context: UseContext, request: Request) -> Response:
    """Return the .sg file."""
    result = _result_of(job)
    headers = {
        "ETag": f'"{result.sha256[:32]}"',
        **_cache_headers(request, job, context),
        "Content-Disposition": f'attachment; filename="{job.id}.sg"',
    }
    if (answer := not_modified(request, headers)) is not None:
        return answer
    with await context.store(_open_bitstream, context, job, result) as file:
        data = await context.store(file.read)
    return Response(data, headers=headers, media_type=BITSTREAM_TYPE)


async def preview_of_job(job: KnownJob, context: UseContext, request: Request) -> Response:
    """Return a bitstream about as large as the final one, but coarser; the final one once the job is done.

    Profile rd updates it at most once a second; profile paper has no preview.
    """
    headers = {"Cache-Control": "private, no-cache"}
    key = job.result.bitstream_key if job.result else preview_key(job.id, job.attempt)
    try:
        data = await context.store(context.storage.get, key)
    except FileNotFoundError:
        return Response(status_code=204, headers=headers)
    headers["ETag"] = f'"{hashlib.sha256(data).hexdigest()[:32]}"'
    return not_modified(request, headers) or Response(data, headers=headers, media_type=BITSTREAM_TYPE)


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
    if media_type(request) == FORM_TYPE:
        raise ProblemError(415, "the body must be the image itself, not a form", headers={"Accept": "image/*"})
    response.headers.update(NEVER_STORED)
    async with body_as_file(request) as image:
        return await while_client_waits(request, context.tasks.preview(caller.client, image, query.bytes))


async def comparison(job: KnownJob, kind: ComparisonFormat, context: UseContext, request: Request) -> Response:
    """Return the job's image as a JPEG, WebP or AVIF of the same size as its bitstream, or up to 3 % smaller.

    If no quality setting gives such a file, the next larger one. For a picture beyond 3 megapixels the size may be
    further off, as a sample of it says which settings to try. For a screenshot or a drawing, WebP is lossless if that
    is no larger, and AVIF is 4:4:4. 410 once the image has been deleted.
    """
    size = int(_result_of(job).stats["bytes"])
    if max(job.image.width, job.image.height) > MAX_SIDES[kind]:
        raise ProblemError(422, f"the picture has more than {MAX_SIDES[kind]:,} pixels per side, too many for {kind}")
    check_image_kept(job, context)  # also refuses a cached file
    headers = {
        "ETag": f'"{job.id}-comparison.{kind}"',
        **_cache_headers(request, job, context, _image_until(job, context)),
    }

    async def draw() -> bytes:
        with await context.store(open_image, context, job) as image:
            pixels = job.image.width * job.image.height
            return await context.tasks.compare(request.state.caller.client, image, kind, size, pixels)

    return await _cached_response(request, context, headers, kind, draw)


def open_image(context: Context, job: Job) -> BinaryIO:
    """Open the image of a job. Raises ProblemError 410 when its retention time is over, even if it still exists."""
    check_image_kept(job, context)
    try:
        return context.storage.open(source_key(job.id))
    except FileNotFoundError:
        raise _image_deleted() from None


def check_image_kept(job: Job, context: Context) -> None:
    """Raise ProblemError 410 if the retention time of a job's image is over."""
    until = _image_until(job, context)
    if until is not None and time.time() >= until:
        raise _image_deleted()


def _image_until(job: Job, context: Context) -> float | None:
    return None if job.finished_at is None else job.finished_at + context.settings.source_retention_s


def _image_deleted() -> ProblemError:
    return ProblemError(410, "the image of this job has been deleted; send it again")


def _result_of(job: Job) -> EncodeResult:
    """Return the result of a finished job. Raises ProblemError 409 with the state of any other."""
    if job.result is not None:
        return job.result
    detail = f"the job is {job.state}"
    if job.state == "failed" and job.error is not None:
        detail += f": {job.error.detail}"
    raise ProblemError(409, detail, state=job.state)


def _open_bitstream(context: Context, job: Job, result: EncodeResult) -> BinaryIO:
    try:
        return context.storage.open(result.bitstream_key)
    except FileNotFoundError as error:
        if context.table.get(job.id) is None:  # removed meanwhile
            raise no_such_job() from None
        raise _damaged(job, error) from error


def _damaged(job: Job, error: Exception) -> ProblemError:
    log.error("job %s: its bitstream is damaged: %s", job.id, error)
    return ProblemError(500, "the bitstream of this job is missing or damaged")


def _cache_headers(request: Request, job: Job, context: Context, image_until: float | None = None) -> dict[str, str]:
    """Return the caching headers of a file.

    A response to a link is cached no longer than the link is valid, and a file made from the image no longer than until
    image_until.
    """
    ends = [end for end in (request.state.caller.link_expires, image_until) if end is not None]
    max_age_s = min([MAX_CACHED_S, *(max(0, int(end - time.time())) for end in ends)])
    # Private, because the URL contains a secret id, which shared caches should not store.
    headers = {"Cache-Control": f"private, max-age={max_age_s}, immutable"}
    if (removed := models.expires_at(job, context.settings)) is not None:
        ends.append(removed)
    return {**headers, "Expires": formatdate(min(ends), usegmt=True)} if ends else headers
