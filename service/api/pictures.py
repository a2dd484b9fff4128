"""Handlers that return pictures, bitstreams, previews, and files of other codecs at the same size."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping
from typing import Annotated, BinaryIO

from fastapi import Depends, Query, Request, Response
from pydantic import Field

from service.api import files, requests
from service.api.context import Context, KnownJob, UseCaller, UseContext, context_of
from service.api.problems import ProblemError
from service.pictures import MEDIA_TYPES, WRITERS, ComparisonFormat, PictureFormat, PictureOptions
from service.sandbox.frames import PreviewFigures
from service.storage.files import preview_key, source_key

PictureQuery = Annotated[PictureOptions, Query()]
AcceptedFormat = Annotated[PictureFormat, Depends(requests.accepted_format)]

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


async def picture(job: KnownJob, kind: PictureFormat, query: PictureQuery, request: Request) -> Response:
    """Return the decoded picture, whole or in part."""
    return await files.picture_response(request, job, kind, query)


async def picture_as_accepted(job: KnownJob, kind: AcceptedFormat, query: PictureQuery, request: Request) -> Response:
    """Return the decoded picture in the format that the Accept header prefers; PNG if it has no preference."""
    answer = await files.picture_response(request, job, kind, query)
    answer.headers.update(requests.VARIES)
    return answer


async def picture_of_body_as(kind: PictureFormat, query: PictureQuery, request: Request) -> Response:
    """Decode the bitstream in the body. Nothing is stored."""
    return await _drawn_body(request, kind, query, requests.NEVER_STORED)


async def picture_of_body(kind: AcceptedFormat, query: PictureQuery, request: Request) -> Response:
    """Decode the bitstream in the body to the format that the Accept header prefers. Nothing is stored."""
    return await _drawn_body(request, kind, query, {**requests.NEVER_STORED, **requests.VARIES})


async def _drawn_body(
    request: Request, kind: PictureFormat, options: PictureOptions, headers: Mapping[str, str]
) -> Response:
    tasks, client = context_of(request).tasks, request.state.caller.client
    async with requests.body_as_file(request) as upload:
        drawing = tasks.draw(client, upload.file, options, kind, max_gaussians=MAX_GAUSSIANS)
        file = await requests.while_client_waits(request, drawing)
    return Response(file, headers=headers, media_type=MEDIA_TYPES[kind])


async def bitstream(job: KnownJob, request: Request) -> Response:
    """Return the .sg file."""
    return await files.bitstream_response(request, job)


async def preview_of_job(job: KnownJob, context: UseContext, request: Request) -> Response:
    """Return a bitstream about as large as the final one, but coarser; the final one once the job is done.

    Profile rd updates it at most once a second; profile paper has no preview.
    """
    headers = {"Cache-Control": "private, no-cache"}
    try:
        if job.result:
            data = await files.stored_bitstream(context, job, job.result)
        else:
            data = await context.store(context.storage.get, preview_key(job.id, job.attempt))
    except FileNotFoundError:
        return Response(status_code=204, headers=headers)
    headers["ETag"] = f'"{hashlib.sha256(data).hexdigest()[:32]}"'
    return files.not_modified(request, headers) or Response(data, headers=headers, media_type=requests.BITSTREAM_TYPE)


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
    job: KnownJob, kind: ComparisonFormat, context: UseContext, caller: UseCaller, request: Request
) -> Response:
    """Return the job's image as a JPEG, WebP or AVIF of the same size as its bitstream, or up to 3 % smaller.

    If no quality setting gives such a file, the next larger one. For a picture beyond 3 megapixels the size may be
    further off, as a sample of it says which settings to try. For a screenshot or a drawing, WebP is lossless if that
    is no larger, and AVIF is 4:4:4. 410 once the image has been deleted.
    """
    size = int(files.result_of(job).stats["bytes"])
    if max(job.image.width, job.image.height) > (limit := WRITERS[kind].max_side):
        raise ProblemError(422, f"the picture has more than {limit:,} pixels per side, too many for {kind}")
    until = (job.finished_at or 0.0) + context.settings.source_retention_s
    if time.time() >= until:  # also refuses a cached file
        raise _image_deleted()
    headers = {"ETag": f'"{job.id}-comparison.{kind}"', **files.cache_headers(request, job, until)}

    async def encode() -> bytes:
        with await context.store(_open_image, context, job.id) as image:
            pixels = job.image.width * job.image.height
            return await context.tasks.compare(caller.client, image, kind, size, pixels)

    return await files.cached_response(request, headers, kind, encode)


def _open_image(context: Context, job_id: str) -> BinaryIO:
    try:
        return context.storage.open(source_key(job_id))
    except FileNotFoundError:
        raise _image_deleted() from None


def _image_deleted() -> ProblemError:
    return ProblemError(410, "the image of this job has been deleted; send it again")
