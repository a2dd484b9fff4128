"""Finished jobs as pictures and as bitstreams, what running ones have so far, what other codecs make of as many bytes,
and pictures of bitstreams that nobody keeps.
"""

from __future__ import annotations

import hashlib
import logging
import time
from collections.abc import Awaitable, Callable
from email.utils import format_datetime
from typing import Annotated, Any, BinaryIO

from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response

from service.jobs.job import EncodeResult, Job
from service.sandbox.client import RefusedError, TaskError
from service.sandbox.drawing import Drawing, Wish
from service.sandbox.picture_files import MAX_SIDES, MEDIA_TYPES, PictureFormat, Rival, RivalFormat
from service.storage.files import bitstream_key, source_key
from service.web.guards.problems import RETRY_SOON_S, ProblemError, problems
from service.web.routes import answers
from service.web.routes.answers import curl
from service.web.routes.decoding import ViewQuery
from service.web.routes.file_answers import (
    IMMUTABLE,
    VARIES,
    accepted_format,
    file_answer,
    has_already,
    not_modified,
)
from service.web.routes.gone import while_client_waits
from service.web.routes.parts import KnownJob, Parts, UseParts, no_such_job
from service.web.submitting.bodies import body_as_file
from sgmethod.errors import BitstreamError, ViewError
from sgmethod.view import View

log = logging.getLogger(__name__)
router = APIRouter()

BITSTREAM_TYPE = "application/octet-stream"
FILE_TYPES = {"sg": BITSTREAM_TYPE, "avif": MEDIA_TYPES["avif"], "webp": MEDIA_TYPES["webp"]}
LATE_S = 60.0
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
PARTIAL: dict[int | str, dict[str, Any]] = {206: {"description": "the part that Range names"}, **problems(412, 416)}
PICTURES = {**_files(*MEDIA_TYPES.values()), **NOT_MODIFIED, **PARTIAL}


def result_of(job: Job) -> EncodeResult:
    """Raises ProblemError 409 with the state if the job is not done."""
    if job.result is not None:
        return job.result
    detail = f"the job is {job.state}"
    if job.state == "failed" and job.error is not None:
        detail += f": {job.error.detail}"
    raise ProblemError(409, detail, state=job.state)


def _open_bitstream(parts: Parts, job: Job, result: EncodeResult) -> BinaryIO:
    try:
        return parts.storage.open(result.bitstream_key)
    except FileNotFoundError as error:
        if parts.table.get(job.id) is None:  # removed while we looked
            raise no_such_job() from None
        raise _late(job.finished_at) or _damaged(job, error) from error


def _late(stored_at: float | None) -> ProblemError | None:
    """The refusal of a file that the storage lacks, if it was stored just now: a store that copies between places may
    have it in a moment.
    """
    if stored_at is None or time.time() > stored_at + LATE_S:
        return None
    detail = "the storage does not have this file yet"
    return ProblemError(503, detail, reason="storage", headers={"Retry-After": RETRY_SOON_S})


def _bitstream(parts: Parts, job: Job, result: EncodeResult) -> bytes:
    with _open_bitstream(parts, job, result) as file:
        return file.read()


def _kept(job: Job, parts: Parts) -> dict[str, str]:
    """How long clients may cache the file, and how long it is kept here."""
    expires = answers.expires_at(job, parts.settings)
    return {"Cache-Control": IMMUTABLE, **({} if expires is None else {"Expires": format_datetime(expires, True)})}


def _damaged(job: Job, error: Exception) -> ProblemError:
    log.error("job %s: its bitstream is damaged: %s", job.id, error)
    return ProblemError(500, "the bitstream of this job is missing or damaged")


async def picture_answer(request: Request, job: Job, query: ViewQuery, kind: PictureFormat, parts: Parts) -> Response:
    """The picture of a job, from memory if it was asked for lately."""
    result = result_of(job)
    wish = query.wish(kind)
    size = (int(result.stats["width"]), int(result.stats["height"]))
    try:
        drawing = Drawing.of(wish, size, parts.settings.max_pixels)
    except ViewError as error:
        raise ProblemError(422, str(error)) from error
    if result.format != "sg" and (drawing.view != View() or (query.quality and kind == result.format)):
        detail = f"the file of this job is {result.format.upper()}, which is only decoded whole and at its own size"
        raise ProblemError(422, detail)
    etag = drawing.etag(result.sha256)
    headers = {"ETag": etag, **_kept(job, parts), **query.disposition()}
    if has_already(request, etag):
        return not_modified(headers)

    async def made() -> bytes:
        if kind == result.format:
            return await to_thread.run_sync(_bitstream, parts, job, result)
        with await to_thread.run_sync(_open_bitstream, parts, job, result) as bitstream:
            try:
                return await _drawn(request, parts, bitstream, wish, is_image=result.format != "sg")
            except BitstreamError as error:
                raise _damaged(job, error) from error

    return file_answer(request, await _remembered(request, parts, etag, made), MEDIA_TYPES[kind], headers)


async def _remembered(request: Request, parts: Parts, etag: str, made: Callable[[], Awaitable[bytes]]) -> bytes:
    """The picture file of that name, from memory if it was asked for lately. Raises ProblemError 429 or 503."""
    file = parts.pictures.get(etag)
    parts.metrics.cache.labels("no" if file is None else "yes").inc()
    client = request.state.caller.client
    parts.outflow.check(client)
    if file is None:
        file = await made()
        parts.pictures.put(etag, file)
        parts.outflow.check(client)  # again: others of its pictures may be on their way by now
    return file


async def _drawn(
    request: Request,
    parts: Parts,
    bitstream: BinaryIO,
    wish: Wish,
    max_gaussians: int | None = None,
    *,
    is_image: bool = False,
) -> bytes:
    """The picture file. Raises BitstreamError, ProblemError 422, 429 or 503."""
    try:
        with parts.metrics.decode_seconds.time():
            drawn = parts.work.draw(request.state.caller.client, bitstream, wish, max_gaussians, is_image=is_image)
            return await while_client_waits(request, drawn)
    except RefusedError as error:
        if error.kind is BitstreamError:
            raise BitstreamError(str(error)) from error
        raise ProblemError(422, str(error)) from error
    except TaskError as error:
        raise ProblemError(422, str(error)) from error


@router.get(
    "/decode/{job_id}.{kind}",
    response_class=Response,
    responses={**PICTURES, **problems(404, 409, 422, 429, 503)},
    summary="The picture of a job",
    openapi_extra=curl("'HOST/decode/ID.webp?width=320' -o photo.webp"),
)
async def picture(
    job: KnownJob, kind: PictureFormat, query: Annotated[ViewQuery, Query()], parts: UseParts, request: Request
) -> Response:
    """The decoded picture, whole or in part, as PNG, JPEG, WebP or AVIF."""
    return await picture_answer(request, job, query, kind, parts)


@router.get(
    "/decode/{job_id}",
    response_class=Response,
    responses={**PICTURES, **problems(404, 406, 409, 422, 429, 503)},
    summary="The picture of a job, by Accept header",
    openapi_extra=curl("-H 'Accept: image/avif' HOST/decode/ID -o photo.avif"),
)
async def picture_as_accepted(
    job: KnownJob, query: Annotated[ViewQuery, Query()], parts: UseParts, request: Request
) -> Response:
    """The decoded picture in the format that the Accept header prefers; PNG if it has no preference."""
    answer = await picture_answer(request, job, query, accepted_format(request), parts)
    answer.headers.update(VARIES)
    return answer


@router.post(
    "/decode",
    response_class=Response,
    responses={**_files(*MEDIA_TYPES.values()), **problems(406, 408, 413, 422, 429, 503)},
    summary="Decode a bitstream, by Accept header",
    openapi_extra={"requestBody": BITSTREAM_BODY, **curl("--data-binary @photo.sg HOST/decode -o photo.png")},
)
async def picture_of_body(query: Annotated[ViewQuery, Query()], parts: UseParts, request: Request) -> Response:
    """Decode the bitstream in the body to the format that the Accept header prefers. Nothing is stored."""
    answer = await _draw_body(request, query, accepted_format(request), parts)
    answer.headers.update(VARIES)
    return answer


@router.post(
    "/decode.{kind}",
    response_class=Response,
    responses={**_files(*MEDIA_TYPES.values()), **problems(404, 408, 413, 422, 429, 503)},
    summary="Decode a bitstream",
    openapi_extra={
        "requestBody": BITSTREAM_BODY,
        **curl("--data-binary @photo.sg 'HOST/decode.jpg?quality=80&scale=0.5' -o small.jpg"),
    },
)
async def picture_of_body_as(
    kind: PictureFormat, query: Annotated[ViewQuery, Query()], parts: UseParts, request: Request
) -> Response:
    """Decode the bitstream in the body. Nothing is stored."""
    return await _draw_body(request, query, kind, parts)


async def _draw_body(request: Request, query: ViewQuery, kind: PictureFormat, parts: Parts) -> Response:
    wish = query.wish(kind)
    parts.outflow.check(request.state.caller.client)
    async with body_as_file(request, parts.settings.max_upload_bytes) as upload:
        try:
            file = await _drawn(request, parts, upload.file, wish, parts.settings.max_decode_gaussians)
        except BitstreamError as error:
            raise ProblemError(422, str(error)) from error
    parts.outflow.check(request.state.caller.client)  # again: others of its pictures may be on their way by now
    return Response(file, headers={**NOTHING_KEPT, **query.disposition()}, media_type=MEDIA_TYPES[kind])


@router.get(
    "/bitstreams/{job_id}.sg",
    response_class=Response,
    responses={**_files(*FILE_TYPES.values()), **NOT_MODIFIED, **PARTIAL, **problems(404, 409, 503)},
    summary="The bitstream of a job",
    openapi_extra=curl("HOST/bitstreams/ID.sg -o photo.sg"),
)
async def bitstream(job: KnownJob, parts: UseParts, request: Request) -> Response:
    """The .sg file, or the AVIF or WebP in its place if the job has a `fallback` and took it: see its media type."""
    return await bitstream_answer(request, job, parts)


@router.get(
    "/jobs/{job_id}/preview.sg",
    response_class=Response,
    responses={
        **_files(BITSTREAM_TYPE),
        204: {"description": "no preview yet"},
        **NOT_MODIFIED,
        **problems(404, 412, 503),
    },
    summary="Preview of a running job",
    openapi_extra=curl("HOST/jobs/ID/preview.sg -o preview.sg"),
)
async def preview(job: KnownJob, parts: UseParts, request: Request) -> Response:
    """A bitstream about as large as the final one, but coarser; the final one once the job is done. Profile rd updates
    it at most once a second; the other profiles have no preview.
    """
    headers = {"Cache-Control": "private, no-cache"}
    key = job.result.bitstream_key if job.result else bitstream_key(job.id, job.attempt)
    try:
        data = await to_thread.run_sync(parts.storage.get, key)
    except FileNotFoundError:
        return Response(status_code=204, headers=headers)
    headers["ETag"] = f'"{hashlib.sha256(data).hexdigest()[:32]}"'
    if has_already(request, headers["ETag"]):
        return not_modified(headers)
    media_type = BITSTREAM_TYPE if job.result is None else FILE_TYPES[job.result.format]
    return Response(data, headers=headers, media_type=media_type)


async def bitstream_answer(request: Request, job: Job, parts: Parts) -> Response:
    """The bitstream of a job."""
    result = result_of(job)
    headers = {
        "ETag": f'"{result.sha256[:32]}"',
        **_kept(job, parts),
        "Content-Disposition": f'attachment; filename="{job.id}.{result.format}"',
    }
    if has_already(request, headers["ETag"]):
        return not_modified(headers)
    data = await to_thread.run_sync(_bitstream, parts, job, result)
    return file_answer(request, data, FILE_TYPES[result.format], headers)


def open_image(parts: Parts, job: Job) -> BinaryIO:
    """The image of a job. Raises ProblemError 410 if it is kept no longer, whether or not it has been removed yet."""
    kept_s = parts.settings.source_retention_s
    if job.finished_at is None or time.time() < job.finished_at + kept_s:
        try:
            return parts.storage.open(source_key(job.id))
        except FileNotFoundError:
            if (refusal := _late(job.created_at)) is not None:
                raise refusal from None
    raise ProblemError(410, "the image of this job has been deleted; send it again")


@router.get(
    "/jobs/{job_id}/rival.{kind}",
    response_class=Response,
    responses={
        **_files(*(MEDIA_TYPES[kind] for kind in ("jpg", "webp", "avif"))),
        **NOT_MODIFIED,
        **PARTIAL,
        **problems(404, 409, 410, 422, 429, 503),
    },
    summary="The same image in another codec, at the same size",
    openapi_extra=curl("HOST/jobs/ID/rival.avif -o rival.avif"),
)
async def rival(job: KnownJob, kind: RivalFormat, parts: UseParts, request: Request) -> Response:
    """The job's image as a JPEG, WebP or AVIF of the same size as its bitstream, or up to 3 % smaller. If no quality
    setting gives such a file, the next larger one. Of a screenshot or a drawing, WebP is lossless where that is no
    larger, and AVIF in 4:4:4. 410 once the image has been deleted.
    """
    result = result_of(job)
    size = int(result.stats["bytes"])
    if max(job.image.width, job.image.height) > MAX_SIDES[kind]:
        raise ProblemError(422, f"the picture has more than {MAX_SIDES[kind]:,} pixels per side, too many for {kind}")
    etag = f'"{job.id}-rival.{kind}"'
    headers = {"ETag": etag, **_kept(job, parts)}
    if has_already(request, etag):
        return not_modified(headers)

    async def made() -> bytes:
        with await to_thread.run_sync(open_image, parts, job) as image:
            making = parts.work.make_rival(request.state.caller.client, image, Rival(kind, size))
            try:
                return await while_client_waits(request, making)
            except TaskError as error:
                raise ProblemError(422, str(error)) from error

    return file_answer(request, await _remembered(request, parts, etag, made), MEDIA_TYPES[kind], headers)
