"""Accepting jobs, and telling how they fare."""

from __future__ import annotations

from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response

from service import views
from service.jobs import PRIORITIES, Job, KeyReusedError, NewJob, QueueFullError
from service.parts import KnownJob, Parts, UseParts
from service.problems import ProblemError, problems
from service.storage import source_key
from service.submission import (
    FORM_TYPE,
    IMAGE_FIELD,
    Wanted,
    check_content_type,
    idempotency_key,
    new_job,
    submission,
)
from sgmethod.budget import BUDGET_KINDS
from sgmethod.profiles import PROFILE_NAMES

router = APIRouter()

RETRY_AFTER_QUEUE_S = "10"
NEVER_STORED = {"Cache-Control": "no-store"}

FIELD_SCHEMAS: dict[str, dict[str, Any]] = {
    **{kind: {"type": "number", "exclusiveMinimum": 0} for kind in BUDGET_KINDS},
    "profile": {"type": "string", "enum": list(PROFILE_NAMES)},
    "time_limit_s": {"type": "number", "exclusiveMinimum": 0},
    "priority": {"type": "string", "enum": list(PRIORITIES)},
}
BINARY: dict[str, Any] = {"type": "string", "format": "binary"}
FORM: dict[str, Any] = {
    "type": "object",
    "required": [IMAGE_FIELD],
    "additionalProperties": False,
    "properties": {IMAGE_FIELD: BINARY, **FIELD_SCHEMAS},
    "oneOf": [{"required": [kind]} for kind in BUDGET_KINDS],
}
IDEMPOTENCY_KEY: dict[str, Any] = {
    "name": "Idempotency-Key",
    "in": "header",
    "description": "the same key again answers with the job it first made",
    "schema": {"type": "string", "maxLength": 255, "pattern": "^[!-~]+$"},
}
ENCODE_EXTRA: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "description": "a form with the image and the fields, or the image alone and the fields in the query",
        "content": {FORM_TYPE: {"schema": FORM}, "image/*": {"schema": BINARY}},
    },
    "parameters": [
        IDEMPOTENCY_KEY,
        *({"name": name, "in": "query", "schema": schema} for name, schema in FIELD_SCHEMAS.items()),
    ],
}


def _queue_full() -> ProblemError:
    return ProblemError(429, "the queue is full; try later", headers={"Retry-After": RETRY_AFTER_QUEUE_S})


@router.post(
    "/encode",
    status_code=202,
    responses=problems(400, 408, 413, 415, 422, 429, 503),
    openapi_extra=ENCODE_EXTRA,
)
async def encode(request: Request, response: Response, parts: UseParts) -> views.AcceptedView:
    """Accept an image to be encoded, with exactly one budget."""
    check_content_type(request)
    key = idempotency_key(request)
    if await to_thread.run_sync(_is_hopeless, parts, key):  # before the body is read
        raise _queue_full()
    async with submission(request, parts.settings) as submitted, parts.accepting:
        image = await submitted.image_bytes(parts.settings.max_upload_bytes)
        job = await to_thread.run_sync(_accept, parts, submitted.wanted, image, key)
    view = views.accepted(job)
    response.headers["Location"] = view.status_url
    response.headers.update(NEVER_STORED)
    return view


def _is_hopeless(parts: Parts, key: str | None) -> bool:
    """Whether the queue is full and the request not a repetition either."""
    if parts.backend.queued() < parts.settings.queue_length:
        return False
    return key is None or parts.backend.find_key(key) is None


def _accept(parts: Parts, wanted: Wanted, image: bytes, key: str | None) -> Job:
    """The image to the disk, then the job to the table; only then may the client be told."""
    new = new_job(image, wanted, key, None, parts.settings)
    try:
        parts.storage.put(source_key(new.id), image)
    except OSError as error:
        raise ProblemError(503, f"the image cannot be stored: {error.strerror}") from error
    job, accepted = _submit(parts, new)
    if not accepted:
        parts.storage.delete(source_key(new.id))
    return job


def _submit(parts: Parts, new: NewJob) -> tuple[Job, bool]:
    # If the table fails, the image stays for the sweep: the row may have been written all the same.
    try:
        return parts.backend.submit(new, parts.settings.queue_length)
    except QueueFullError:
        refusal = _queue_full()
    except KeyReusedError:
        refusal = ProblemError(422, "this Idempotency-Key was used for another request")
    parts.storage.delete(source_key(new.id))
    raise refusal


@router.get("/jobs/{job_id}", responses=problems(404, 503))
def status(job: KnownJob, parts: UseParts, response: Response) -> views.JobView:
    """State, place in the queue, progress, trace so far, and result or error."""
    response.headers.update(NEVER_STORED)
    return views.with_trace(job, parts.backend.trace(job.id))


@router.get("/jobs", responses=problems(422, 503))
def jobs(
    parts: UseParts,
    response: Response,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    before: Annotated[int | None, Query(ge=1, le=2**53)] = None,
) -> views.JobPage:
    """All jobs, newest first, a page at a time."""
    response.headers.update(NEVER_STORED)
    page = parts.backend.page(limit + 1, before)
    older = f"/jobs?limit={limit}&before={page[limit - 1].number}" if len(page) > limit else None
    return views.JobPage(jobs=[views.summary(job) for job in page[:limit]], next=older)


@router.delete("/jobs/{job_id}", status_code=204, responses=problems(404, 503))
def remove(job: KnownJob, parts: UseParts) -> None:
    """Cancel the job if it is not done, and remove all that is kept of it."""
    removed = parts.backend.remove(job.id)
    if removed is None:
        return
    # A worker that runs it finds its claim gone at the next heartbeat, and cleans up behind itself.
    parts.storage.delete(source_key(removed.id))
    if removed.result is not None:
        parts.storage.delete(removed.result.bitstream_key)
