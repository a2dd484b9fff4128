"""Finished jobs as pictures and as bitstreams."""

from __future__ import annotations

from typing import Any

from anyio import to_thread
from fastapi import APIRouter, Request, Response

from service.jobs import EncodeResult, Job
from service.parts import KnownJob, Parts, UseParts, no_such_job
from service.problems import MEDIA_TYPE, ProblemError

router = APIRouter()

BITSTREAM_TYPE = "application/octet-stream"
# The bytes behind an id never change. Private, because an id is a secret that shared caches should not keep.
IMMUTABLE = "private, max-age=31536000, immutable"


def _responses(media_type: str) -> dict[int | str, dict[str, Any]]:
    problem = {"content": {MEDIA_TYPE: {}}, "description": "a problem"}
    schema = {"type": "string", "format": "binary"}
    return {
        200: {"content": {media_type: {"schema": schema}}},
        304: {"description": "the client has it already"},
        **dict.fromkeys((404, 409, 503), problem),
    }


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


async def _bitstream(parts: Parts, job: Job, result: EncodeResult) -> bytes:
    try:
        return await to_thread.run_sync(parts.storage.get, result.bitstream_key)
    except FileNotFoundError:
        if await to_thread.run_sync(parts.backend.get, job.id) is None:  # removed while we looked
            raise no_such_job() from None
        raise


@router.head("/decode/{job_id}.png", include_in_schema=False)
@router.get("/decode/{job_id}.png", response_class=Response, responses=_responses("image/png"))
async def picture(job: KnownJob, parts: UseParts, request: Request) -> Response:
    """The decoded picture as PNG."""
    result = _result(job)
    headers = {"ETag": f'"{result.sha256[:32]}.png"', "Cache-Control": IMMUTABLE}
    if _has_already(request, headers["ETag"]):
        return Response(status_code=304, headers=headers)
    png = await parts.decoder.png(await _bitstream(parts, job, result))
    return Response(png, headers=headers, media_type="image/png")


@router.head("/bitstreams/{job_id}.sg", include_in_schema=False)
@router.get("/bitstreams/{job_id}.sg", response_class=Response, responses=_responses(BITSTREAM_TYPE))
async def bitstream(job: KnownJob, parts: UseParts, request: Request) -> Response:
    """The bitstream itself."""
    result = _result(job)
    headers = {"ETag": f'"{result.sha256[:32]}"', "Cache-Control": IMMUTABLE}
    if _has_already(request, headers["ETag"]):
        return Response(status_code=304, headers=headers)
    headers["Content-Disposition"] = f'attachment; filename="{job.id}.sg"'
    return Response(await _bitstream(parts, job, result), headers=headers, media_type=BITSTREAM_TYPE)
