"""Jobs: accepted, looked at, listed, linked to, removed."""

from __future__ import annotations

import logging
import time
from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response

from service.jobs.job import Job, JobState, NewJob
from service.jobs.table import KeyReusedError, OwnQueueFullError, QueueFullError, QuotaError, Room
from service.keys import Link
from service.storage.files import source_key
from service.web.guards.problems import ProblemError, problems
from service.web.routes import answers
from service.web.routes.answers import curl
from service.web.routes.file_answers import NEVER_STORED, has_already
from service.web.routes.parts import KnownJob, Parts, UseCaller, UseParts, no_such_job
from service.web.routes.pictures import open_image
from service.web.routes.waiting import ENCODED, WAIT_PARAMETERS, job_within, outcome, wished_wait_s
from service.web.submitting.feasible import feasible
from service.web.submitting.fields import FIELD_SCHEMAS, IMAGE_FIELD
from service.web.submitting.submission import (
    FORM_TYPE,
    check_content_type,
    fields_without_image,
    idempotency_key,
    new_job,
    read_header,
    submission,
)

log = logging.getLogger(__name__)
router = APIRouter()

RETRY_AFTER_QUEUE_S = "5"
LONGEST_LINK_S = 7 * 86_400

BINARY: dict[str, Any] = {"type": "string", "format": "binary"}
FORM: dict[str, Any] = {
    "type": "object",
    "required": [IMAGE_FIELD],
    "additionalProperties": False,
    "properties": {IMAGE_FIELD: BINARY, **FIELD_SCHEMAS},
}
IDEMPOTENCY_KEY: dict[str, Any] = {
    "name": "Idempotency-Key",
    "in": "header",
    "description": "the same key again answers with the job it first made",
    "schema": {"type": "string", "maxLength": 255, "pattern": "^[!-~]+$"},
}
ENCODE_PARAMETERS = [
    IDEMPOTENCY_KEY,
    *WAIT_PARAMETERS,
    *({"name": name, "in": "query", "schema": schema} for name, schema in FIELD_SCHEMAS.items()),
]
ENCODE_EXTRA: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "description": "a form with the image and the options, or the image itself with the options in the query",
        "content": {FORM_TYPE: {"schema": FORM}, "image/*": {"schema": BINARY}},
    },
    "parameters": ENCODE_PARAMETERS,
}
AGAIN_FORM: dict[str, Any] = {"type": "object", "additionalProperties": False, "properties": FIELD_SCHEMAS}
AGAIN_EXTRA: dict[str, Any] = {
    "requestBody": {
        "required": False,
        "description": "the options, unless they are in the query",
        "content": {FORM_TYPE: {"schema": AGAIN_FORM}},
    },
    "parameters": ENCODE_PARAMETERS,
}


def _queue_full() -> ProblemError:
    retry = {"Retry-After": RETRY_AFTER_QUEUE_S}
    return ProblemError(429, "the queue is full; try again later", reason="queue", headers=retry)


def _own_queue_full(limit: int) -> ProblemError:
    retry = {"Retry-After": RETRY_AFTER_QUEUE_S}
    detail = f"this API key already has {limit} jobs waiting; try again later"
    return ProblemError(429, detail, reason="own_queue", headers=retry)


@router.post(
    "/encode",
    status_code=202,
    response_model=answers.AcceptedView,
    responses={**ENCODED, **problems(400, 406, 408, 409, 413, 415, 422, 429, 500, 503)},
    summary="Encode an image",
    openapi_extra={**ENCODE_EXTRA, **curl("--fail -F image=@photo.jpg -F bpp=0.3 'HOST/encode?wait=50' -o photo.sg")},
)
async def encode(
    request: Request, response: Response, parts: UseParts, caller: UseCaller
) -> answers.AcceptedView | Response:
    """Submit an image for encoding, with at most one budget. With `wait`, the response is the finished file (or the
    decoded picture, if the Accept header asks for one) when the job is done in time; otherwise 202 and the job as JSON.
    """
    check_content_type(request)
    wait_s, key = wished_wait_s(request), idempotency_key(request)
    await to_thread.run_sync(_check_queue, parts, key, caller.owner)  # before the body is read
    async with submission(request, parts.settings) as submitted:
        header = await read_header(submitted, parts.work, caller.client)
        asked = feasible(submitted.asked, header)
        async with parts.accepting.turn(caller.client):
            image = await submitted.image_bytes()
            new = await to_thread.run_sync(new_job, asked, header, image, key, caller.owner)
            job = await to_thread.run_sync(_accept, parts, new, image)
    return await _accepted(request, response, parts, job, wait_s)


@router.post(
    "/jobs/{job_id}/encode",
    status_code=202,
    response_model=answers.AcceptedView,
    responses={**ENCODED, **problems(400, 404, 406, 408, 409, 410, 413, 415, 422, 429, 500, 503)},
    summary="Re-encode a job's image",
    openapi_extra={**AGAIN_EXTRA, **curl("-X POST 'HOST/jobs/ID/encode?bpp=0.5'")},
)
async def encode_again(
    job: KnownJob, request: Request, response: Response, parts: UseParts, caller: UseCaller
) -> answers.AcceptedView | Response:
    """Start a new job with the image of an existing one, without uploading it again; 410 once that image has been
    deleted. Takes the options of `POST /encode`, in the query or in a form.
    """
    wait_s, key = wished_wait_s(request), idempotency_key(request)
    asked = (await fields_without_image(request)).asked(parts.settings.max_time_limit_s)
    asked = feasible(asked, job.image)
    await to_thread.run_sync(_check_queue, parts, key, caller.owner)
    async with parts.accepting.turn(caller.client):
        image = await to_thread.run_sync(_kept_image, parts, job)
        new = await to_thread.run_sync(new_job, asked, job.image, image, key, caller.owner)
        again = await to_thread.run_sync(_accept, parts, new, image)
    return await _accepted(request, response, parts, again, wait_s)


def _kept_image(parts: Parts, job: Job) -> bytes:
    """Raises ProblemError 410."""
    with open_image(parts, job) as file:
        return file.read()


async def _accepted(
    request: Request, response: Response, parts: Parts, job: Job, wait_s: int
) -> answers.AcceptedView | Response:
    """The response for an accepted job, or its result if the client waits for it."""
    view = answers.accepted(job, parts.settings)
    headers = {"Location": view.status_url, **NEVER_STORED}
    if wait_s:
        headers["Preference-Applied"] = f"wait={wait_s}"
        done = await job_within(request, job, wait_s, parts)
        if done is not None:
            return await outcome(request, done, parts, headers)
    response.headers.update(headers)
    return view


def _check_queue(parts: Parts, key: str | None, owner: str | None) -> None:
    """Raises ProblemError 429 if the queue is full, or the owner's part of it, and the request no repetition."""
    own_limit = parts.settings.max_queued_per_key
    if parts.table.queued() >= parts.settings.queue_length:
        refusal = _queue_full()
    elif owner is not None and own_limit and parts.table.queued(owner) >= own_limit:
        refusal = _own_queue_full(own_limit)
    else:
        return
    if key is None or parts.table.find_by_key(key, owner) is None:
        raise refusal


def _accept(parts: Parts, new: NewJob, image: bytes) -> Job:
    """Store the image, then put the job into the job table; only then may the client be told."""
    free_bytes = parts.storage.free_bytes()
    if free_bytes is not None and free_bytes - len(image) < parts.settings.min_free_bytes:
        retry = {"Retry-After": RETRY_AFTER_QUEUE_S}
        raise ProblemError(503, "the disk is full", reason="disk", headers=retry)
    try:
        parts.storage.put(source_key(new.id), image)
    except OSError as error:
        log.error("an image cannot be stored: %s", error)
        retry = {"Retry-After": RETRY_AFTER_QUEUE_S}
        raise ProblemError(503, "the image cannot be stored right now", reason="storage", headers=retry) from error
    job, accepted = _submit(parts, new)
    if accepted:
        parts.metrics.accept(new.owner)
    else:
        _discard(parts, source_key(new.id))
    return job


def _discard(parts: Parts, key: str) -> None:
    """Remove what no job needs any more. Where that fails it is left to the sweep: what was asked for is done."""
    try:
        parts.storage.delete(key)
    except OSError as error:
        log.warning("%s cannot be removed yet: %s", key, error)


def _submit(parts: Parts, new: NewJob) -> tuple[Job, bool]:
    # If the table fails, the image stays for the sweep: the row may have been written anyway.
    limits = parts.settings
    own_limit, own_quota = (limits.max_queued_per_key, limits.quota_bytes_per_key) if new.owner is not None else (0, 0)
    room = Room(limits.queue_length, own_limit, limits.quota_bytes, own_quota)
    try:
        return parts.table.submit(new, room)
    except QuotaError as error:
        whose, reason = ("this API key", "own_quota") if error.of_owner else ("the service", "quota")
        detail = f"{whose} has reached its storage quota; remove jobs first"
        refusal = ProblemError(429, detail, reason=reason, headers={"Retry-After": RETRY_AFTER_QUEUE_S})
    except OwnQueueFullError:
        refusal = _own_queue_full(own_limit)
    except QueueFullError:
        refusal = _queue_full()
    except KeyReusedError:
        refusal = ProblemError(422, "this Idempotency-Key was already used for a different request")
    _discard(parts, source_key(new.id))
    raise refusal


@router.get("/jobs/{job_id}", responses=problems(404, 503), summary="Get a job", openapi_extra=curl("HOST/jobs/ID"))
def status(job: KnownJob, parts: UseParts, response: Response) -> answers.JobView:
    """State, queue position, progress, trace so far, and the result or error."""
    response.headers.update(NEVER_STORED)
    return answers.with_trace(job, parts.table.trace(job.id), parts.settings)


@router.get(
    "/jobs",
    responses=problems(422, 503),
    summary="List jobs",
    openapi_extra=curl("'HOST/jobs?state=done&limit=20'"),
)
def jobs(
    parts: UseParts,
    caller: UseCaller,
    response: Response,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    before: Annotated[int | None, Query(ge=1, le=2**53)] = None,
    state: Annotated[JobState | None, Query(description="only jobs in this state")] = None,
) -> answers.JobPage:
    """All jobs, newest first, in pages; with API keys, only those of the caller's key."""
    response.headers.update(NEVER_STORED)
    page = parts.table.page(limit + 1, before, caller.owner, state)
    chosen = "" if state is None else f"&state={state}"
    where = f"{parts.settings.root_path}/jobs?limit={limit}"
    older = f"{where}&before={page[limit - 1].number}{chosen}" if len(page) > limit else None
    return answers.JobPage(jobs=[answers.summary(job, parts.settings) for job in page[:limit]], next=older)


@router.post(
    "/jobs/{job_id}/links",
    responses=problems(404, 422, 503),
    summary="Create links that need no API key",
    openapi_extra=curl("-X POST 'HOST/jobs/ID/links?expires_s=600'"),
)
def links(
    job: KnownJob,
    parts: UseParts,
    response: Response,
    expires_s: Annotated[int, Query(ge=1, le=LONGEST_LINK_S, description="seconds until the links expire")] = 3600,
) -> answers.LinksView:
    """Links to the picture and the bitstream that anyone can open until they expire."""
    response.headers.update(NEVER_STORED)
    secret = parts.settings.link_secret.get_secret_value()
    if not secret:
        raise ProblemError(404, "links are not enabled on this server")
    expires = int(time.time()) + expires_s
    picture, bitstream = (Link(resource, job.id, expires).query(secret) for resource in ("decode", "bitstreams"))
    return answers.links(job, picture, bitstream, expires, parts.settings)


@router.post(
    "/jobs/{job_id}/stop",
    status_code=202,
    responses=problems(404, 409, 422, 503),
    summary="Finish an encode early",
    openapi_extra=curl("-X POST HOST/jobs/ID/stop"),
)
def stop(job: KnownJob, parts: UseParts, response: Response) -> answers.AcceptedView:
    """Finish a running job early and keep its result, which stays within the budget. This takes about a quarter of the
    time spent so far. A finished job is unchanged; 409 for a queued or failed one, which has no result to keep.
    """
    view = answers.accepted(job, parts.settings)
    response.headers.update({"Location": view.status_url, **NEVER_STORED})
    if job.state != "done" and not parts.table.stop(job.id):
        now = parts.table.get(job.id)
        if now is None:
            raise no_such_job()
        if now.state != "done":
            raise ProblemError(409, f"the job is {now.state}: there is no result to keep", state=now.state)
    return view


@router.delete(
    "/jobs/{job_id}",
    status_code=204,
    responses=problems(404, 412, 422, 503),
    summary="Cancel and remove a job",
    openapi_extra=curl("-X DELETE HOST/jobs/ID"),
)
def remove(job: KnownJob, parts: UseParts, request: Request) -> None:
    """Cancel the job if it is not done, and delete everything stored for it."""
    has_already(request, None)  # which refuses a condition that fails
    _forget(parts, job.id)


def _forget(parts: Parts, job_id: str) -> None:
    removed = parts.table.remove(job_id)
    if removed is None:
        return
    # A worker that runs it finds its claim gone at the next heartbeat, and cleans up behind itself.
    _discard(parts, source_key(removed.id))
    if removed.result is not None:
        _discard(parts, removed.result.bitstream_key)
