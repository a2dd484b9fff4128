"""New jobs: from a request to a job in the table, whose file is the answer if it is done in time."""

from __future__ import annotations

import hashlib
import json
import logging
import re
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from anyio import to_thread
from fastapi import Request, Response

from service.api import models
from service.api.callers import header_line
from service.api.context import Context, KnownJob, UseCaller, UseContext
from service.api.files import BITSTREAM_TYPE, NEVER_STORED, VARIES, accepted_format
from service.api.options import IMAGE_FIELD, OPTION_SCHEMAS, CheckedOptions, feasible
from service.api.pictures import bitstream_answer, open_image, picture_answer
from service.api.problems import ProblemError
from service.api.uploads import FORM_TYPE, image_and_options, image_type, options_alone, read_header
from service.api.views import PictureQuery
from service.api.waiting import WAIT_PARAMETERS, job_within, wanted_wait_s
from service.jobs.job import (
    Job,
    KeyReusedError,
    NewJob,
    OwnQueueFullError,
    QueueFullError,
    QuotaError,
    SourceImage,
    SubmitLimits,
    new_job_id,
)
from service.logs import log_seldom
from service.storage.files import source_key

log = logging.getLogger(__name__)

RETRY_AFTER = {"Retry-After": "5"}
BINARY: dict[str, Any] = {"type": "string", "format": "binary"}
FORM: dict[str, Any] = {"type": "object", "additionalProperties": False, "properties": OPTION_SCHEMAS}
IMAGE_FORM = {**FORM, "required": [IMAGE_FIELD], "properties": {IMAGE_FIELD: BINARY, **OPTION_SCHEMAS}}
PARAMETERS: list[dict[str, Any]] = [
    {
        "name": "Idempotency-Key",
        "in": "header",
        "description": "the same key again answers with the job it first made",
        "schema": {"type": "string", "maxLength": 255, "pattern": "^[!-~]+$"},
    },
    *WAIT_PARAMETERS,
    *({"name": name, "in": "query", "schema": schema} for name, schema in OPTION_SCHEMAS.items()),
]
ENCODE_BODY: dict[str, Any] = {
    "required": True,
    "description": "a form with the image and the options, or the image itself with the options in the query",
    "content": {FORM_TYPE: {"schema": IMAGE_FORM}, "image/*": {"schema": BINARY}},
}
AGAIN_BODY: dict[str, Any] = {
    "required": False,
    "description": "the options, unless they are in the query",
    "content": {FORM_TYPE: {"schema": FORM}},
}

_IDEMPOTENCY_KEY = re.compile(r"[!-~]{1,255}")


async def encode(
    request: Request, response: Response, context: UseContext, caller: UseCaller
) -> models.AcceptedView | Response:
    """Submit an image for encoding, with at most one budget. With `wait`, the response is the finished file (or the
    decoded picture, if the Accept header asks for one) when the job is done in time; otherwise 202 and the job as JSON.
    """
    image_type(request)
    wait_s, key = wanted_wait_s(request), _idempotency_key(request)
    await to_thread.run_sync(_check_queue, context, key, caller.owner)  # before the body is read
    async with image_and_options(request) as (file, options):
        checked = options.checked(context.settings.max_time_limit_s)
        header = await read_header(file, context.tasks, caller.client)
        checked = feasible(checked, header)
        async with context.accepting.turn(caller.client):
            await file.seek(0)
            image = await file.read()
            job = await to_thread.run_sync(_accept, context, checked, header, image, key, caller.owner)
    return await _accepted(request, response, context, job, wait_s)


async def encode_again(
    job: KnownJob, request: Request, response: Response, context: UseContext, caller: UseCaller
) -> models.AcceptedView | Response:
    """Start a new job with the image of an existing one, without uploading it again; 410 once that image has been
    deleted. Takes the options of `POST /encode`, in the query or in a form.
    """
    wait_s, key = wanted_wait_s(request), _idempotency_key(request)
    checked = (await options_alone(request)).checked(context.settings.max_time_limit_s)
    checked = feasible(checked, job.image)
    await to_thread.run_sync(_check_queue, context, key, caller.owner)
    async with context.accepting.turn(caller.client):
        image = await to_thread.run_sync(_kept_image, context, job)
        again = await to_thread.run_sync(_accept, context, checked, job.image, image, key, caller.owner)
    return await _accepted(request, response, context, again, wait_s)


def _idempotency_key(request: Request) -> str | None:
    key = header_line(request.headers, "idempotency-key")
    if key is not None and _IDEMPOTENCY_KEY.fullmatch(key) is None:
        raise ProblemError(400, "Idempotency-Key must be 1 to 255 visible ASCII characters")
    return key


def _kept_image(context: Context, job: Job) -> bytes:
    """Raises ProblemError 410."""
    with open_image(context, job) as file:
        return file.read()


def _queue_full(own_limit: int = 0) -> ProblemError:
    if own_limit:
        detail = f"this API key already has {own_limit} jobs waiting; try again later"
        return ProblemError(429, detail, reason="own_queue", headers=RETRY_AFTER)
    return ProblemError(429, "the queue is full; try again later", reason="queue", headers=RETRY_AFTER)


def _check_queue(context: Context, key: str | None, owner: str | None) -> None:
    """Raises ProblemError 429 if the queue is full, or the owner's part of it, and the request no repetition."""
    own_limit = context.settings.max_queued_per_key
    if context.table.queued() >= context.settings.queue_length:
        refusal = _queue_full()
    elif owner is not None and context.table.queued(owner) >= own_limit:
        refusal = _queue_full(own_limit)
    else:
        return
    if key is None or context.table.find_by_key(key, owner) is None:
        raise refusal


def _accept(
    context: Context, checked: CheckedOptions, header: SourceImage, image: bytes, key: str | None, owner: str | None
) -> Job:
    """Store the image, then put the job into the job table; only then may the client be told."""
    new = _new_job(checked, header, image, key, owner)
    free_bytes = context.storage.free_bytes()
    if free_bytes is not None and free_bytes - len(image) < context.settings.min_free_bytes:
        log_seldom(log, "new jobs are refused, since the disk is full: %d bytes are free", free_bytes)
        raise ProblemError(503, "the disk is full", reason="disk", headers=RETRY_AFTER)
    try:
        context.storage.put(source_key(new.id), image)
    except OSError as error:
        log_seldom(log, "an image cannot be stored: %s", error)
        detail = "the image cannot be stored right now"
        raise ProblemError(503, detail, reason="storage", headers=RETRY_AFTER) from error
    job, accepted = _submit(context, new)
    if accepted:
        context.metrics.accept(new.owner)
    else:
        context.discard(source_key(new.id))
    return job


def _new_job(checked: CheckedOptions, header: SourceImage, image: bytes, key: str | None, owner: str | None) -> NewJob:
    words = {"encode": asdict(checked.request), "priority": checked.priority}
    digest = hashlib.sha256(json.dumps(words).encode())
    digest.update(image)
    return NewJob(new_job_id(), checked.request, header, digest.hexdigest(), key, owner, checked.priority)


def _submit(context: Context, new: NewJob) -> tuple[Job, bool]:
    # If the table fails, the image stays for the sweep: the row may have been written anyway.
    limits = context.settings
    own_limit, own_quota = (limits.max_queued_per_key, limits.quota_bytes_per_key) if new.owner is not None else (0, 0)
    most = SubmitLimits(limits.queue_length, own_limit, limits.quota_bytes, own_quota)
    try:
        return context.table.submit(new, most)
    except QuotaError as error:
        whose, reason = ("this API key", "own_quota") if error.of_owner else ("the service", "quota")
        detail = f"{whose} has reached its storage quota; remove jobs first"
        refusal = ProblemError(429, detail, reason=reason, headers=RETRY_AFTER)
    except OwnQueueFullError:
        refusal = _queue_full(own_limit)
    except QueueFullError:
        refusal = _queue_full()
    except KeyReusedError:
        refusal = ProblemError(422, "this Idempotency-Key was already used for a different request")
    context.discard(source_key(new.id))
    raise refusal


async def _accepted(
    request: Request, response: Response, context: Context, job: Job, wait_s: int
) -> models.AcceptedView | Response:
    """The response for an accepted job, or its result if the client waits for it."""
    view = models.accepted(job, context.settings)
    headers = {"Location": view.status_url, **NEVER_STORED}
    if wait_s:
        headers["Preference-Applied"] = f"wait={wait_s}"
        ended = await job_within(request, job, wait_s, context)
        if ended is not None:
            return await _outcome(request, ended, context, headers)
    response.headers.update(headers)
    return view


async def _outcome(request: Request, job: Job, context: Context, headers: Mapping[str, str]) -> Response:
    """The result of a finished job: its file, or its decoded picture. Raises ProblemError."""
    if job.error is not None and job.state == "failed":
        status = 422 if job.error.code == "refused" else 500
        raise ProblemError(status, job.error.detail, headers=headers, code=job.error.code, id=job.id)
    accept = (header_line(request.headers, "accept") or "*/*").lower()
    if BITSTREAM_TYPE in accept or "image/" not in accept:
        answer = await bitstream_answer(request, job, context)
    else:
        answer = await picture_answer(request, job, PictureQuery(), accepted_format(request), context)
    answer.headers.update({**headers, **VARIES})
    return answer
