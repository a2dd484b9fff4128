"""Finished jobs as pictures and as bitstreams, and pictures of bitstreams that nobody keeps."""

from __future__ import annotations

import logging
from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response

from service.jobs.job import EncodeResult, Job
from service.web.guards.problems import ProblemError, problems
from service.web.routes.bodies import body_as_file
from service.web.routes.decoding import Drawing, ViewQuery, draw, draw_unknown
from service.web.routes.parts import KnownJob, Parts, UseParts, no_such_job
from service.web.routes.picture_files import MEDIA_TYPES, PictureFormat
from sgmethod.errors import BitstreamError

log = logging.getLogger(__name__)
router = APIRouter()

BITSTREAM_TYPE = "application/octet-stream"
# The bytes behind an id never change. Private, because an id is a secret that shared caches should not keep.
IMMUTABLE = "private, max-age=31536000, immutable"
NOTHING_KEPT = {"Cache-Control": "no-store"}
BITSTREAM_BODY: dict[str, Any] = {
    "required": True,
    "content": {BITSTREAM_TYPE: {"schema": {"type": "string", "format": "binary"}}},
}


def _files(*media_types: str) -> dict[int | str, dict[str, Any]]:
    """A file of one of the types as a response of the OpenAPI document."""
    schema = {"type": "string", "format": "binary"}
    return {200: {"content": {media_type: {"schema": schema} for media_type in media_types}}}


NOT_MODIFIED: dict[int | str, dict[str, Any]] = {304: {"description": "the client has it already"}}


def _result(job: Job) -> EncodeResult:
    """Raises ProblemError 409 with the state if the job is not done."""
    if job.result is not None:
        return job.result
    detail = f"the job is {job.state}"
    if job.state == "failed" and job.error is not None:
        detail += f": {job.error.detail}"
    raise ProblemError(409, detail, state=job.state)


def _has_already(request: Request, etag: str) -> bool:
    """Whether If-None-Match names the tag (RFC 9110, 13.1.2)."""
    tags = [tag.strip().removeprefix("W/") for tag in request.headers.get("if-none-match", "").split(",")]
    return etag in tags or tags == ["*"]


def _bitstream(parts: Parts, job: Job, result: EncodeResult) -> bytes:
    try:
        return parts.storage.get(result.bitstream_key)
    except FileNotFoundError as error:
        if parts.table.get(job.id) is None:  # removed while we looked
            raise no_such_job() from None
        raise _damaged(job, error) from error


def _draw_job(parts: Parts, job: Job, result: EncodeResult, drawing: Drawing) -> bytes:
    try:
        return draw(_bitstream(parts, job, result), drawing)
    except BitstreamError as error:
        raise _damaged(job, error) from error


def _damaged(job: Job, error: Exception) -> ProblemError:
    log.error("job %s: its bitstream is not as it was: %s", job.id, error)
    return ProblemError(500, "the bitstream of this job is missing or damaged")


@router.head("/decode/{job_id}.{kind}", include_in_schema=False)
@router.get(
    "/decode/{job_id}.{kind}",
    response_class=Response,
    responses={**_files(*MEDIA_TYPES.values()), **NOT_MODIFIED, **problems(404, 409, 422, 503)},
)
async def picture(
    job: KnownJob, kind: PictureFormat, query: Annotated[ViewQuery, Query()], parts: UseParts, request: Request
) -> Response:
    """The decoded picture, or a view of it, as PNG, JPEG or WebP."""
    result = _result(job)
    size = (int(result.stats["width"]), int(result.stats["height"]))
    drawing = Drawing.of(query, kind, size, parts.settings.max_decode_pixels)
    headers = {"ETag": drawing.etag(result.sha256), "Cache-Control": IMMUTABLE}
    if _has_already(request, headers["ETag"]):
        return Response(status_code=304, headers=headers)
    file = parts.pictures.get(headers["ETag"])
    parts.metrics.cache.labels("no" if file is None else "yes").inc()
    if file is None:
        parts.outflow.check()
        with parts.metrics.decode_seconds.time():
            file = await parts.decoder.run(_draw_job, parts, job, result, drawing)
        parts.pictures.put(headers["ETag"], file)
    return Response(file, headers=headers, media_type=MEDIA_TYPES[kind])


@router.post(
    "/decode",
    response_class=Response,
    responses={**_files(MEDIA_TYPES["png"]), **problems(408, 413, 422, 503)},
    openapi_extra={"requestBody": BITSTREAM_BODY},
)
async def picture_of_body(query: Annotated[ViewQuery, Query()], parts: UseParts, request: Request) -> Response:
    """A picture of the bitstream in the body, as PNG. Nothing is stored."""
    limits = parts.settings
    parts.outflow.check()
    async with body_as_file(request, limits.max_bitstream_bytes) as upload, parts.accepting:
        data = await upload.read()
        try:
            with parts.metrics.decode_seconds.time():
                file = await parts.decoder.run(
                    draw_unknown, data, query, limits.max_decode_pixels, limits.max_decode_gaussians
                )
        except BitstreamError as error:
            raise ProblemError(422, str(error)) from error
    return Response(file, headers=NOTHING_KEPT, media_type=MEDIA_TYPES["png"])


@router.head("/bitstreams/{job_id}.sg", include_in_schema=False)
@router.get(
    "/bitstreams/{job_id}.sg",
    response_class=Response,
    responses={**_files(BITSTREAM_TYPE), **NOT_MODIFIED, **problems(404, 409, 503)},
)
async def bitstream(job: KnownJob, parts: UseParts, request: Request) -> Response:
    """The bitstream itself."""
    result = _result(job)
    headers = {"ETag": f'"{result.sha256[:32]}"', "Cache-Control": IMMUTABLE}
    if _has_already(request, headers["ETag"]):
        return Response(status_code=304, headers=headers)
    headers["Content-Disposition"] = f'attachment; filename="{job.id}.sg"'
    data = await to_thread.run_sync(_bitstream, parts, job, result)
    return Response(data, headers=headers, media_type=BITSTREAM_TYPE)
