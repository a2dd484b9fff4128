"""From the body of POST /encode to a new job. Everything is checked before the job may be accepted."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import asdict, dataclass

from starlette.datastructures import UploadFile
from starlette.requests import Request

from service.jobs.job import PRIORITIES, EncodeRequest, NewJob, Priority, SourceImage, new_job_id
from service.settings import Settings
from service.web.guards.problems import ProblemError
from service.web.helpers.pool import HelperError, RefusedError
from service.web.helpers.work import Work
from service.web.submitting.bodies import body_as_file
from sgmethod.budget import BUDGET_KINDS, DEFAULT_BUDGET, Budget
from sgmethod.errors import BudgetError
from sgmethod.io.formats import is_read
from sgmethod.profiles import DEFAULT_PROFILE, PROFILE_NAMES, Tune, tuning

IMAGE_FIELD = "image"
FORMAT_BYTES = 256  # of a file, which tell its format
WAIT_FIELD = "wait"  # of the query alone
FIELDS = (*BUDGET_KINDS, "profile", "tune", "time_limit_s", "priority")
MAX_FIELD_BYTES = 256
# What multipart adds to the image itself: boundaries, part headers, the other fields.
MULTIPART_OVERHEAD_BYTES = 16 * 1024

FORM_TYPE, IMAGE_TYPES = "multipart/form-data", "image/"

# Stricter than float(), which also takes "1_0", "nan" and spaces around.
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?")
_IDEMPOTENCY_KEY = re.compile(r"[!-~]{1,255}")


def idempotency_key(request: Request) -> str | None:
    """The Idempotency-Key header. Raises ProblemError 400 if it is not 1 to 255 visible ASCII characters."""
    key = request.headers.get("idempotency-key")
    if key is not None and _IDEMPOTENCY_KEY.fullmatch(key) is None:
        raise ProblemError(400, "Idempotency-Key must be 1 to 255 visible ASCII characters")
    return key


@dataclass(frozen=True)
class Submission:
    """The body of POST /encode, come in whole: the request, and the image as a file."""

    request: EncodeRequest
    priority: Priority
    image: UploadFile

    async def image_bytes(self) -> bytes:
        """The image file."""
        await self.image.seek(0)
        return await self.image.read()


def check_content_type(request: Request) -> str:
    """The body's media type. Raises ProblemError 415 unless it is a form or an image."""
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != FORM_TYPE and not media_type.startswith(IMAGE_TYPES):
        accepted = f"{FORM_TYPE}, {IMAGE_TYPES}*"
        raise ProblemError(415, f"the body must be {FORM_TYPE} or an image", headers={"Accept": accepted})
    return media_type


@asynccontextmanager
async def submission(request: Request, settings: Settings) -> AsyncIterator[Submission]:
    """The body, read as it comes in; what is large goes to temporary files, gone with the context.

    Entering raises ProblemError 408, 413, 415 or 422, or HTTPException 400 on what is no form.
    """
    query = [(name, value) for name, value in request.query_params.multi_items() if name != WAIT_FIELD]
    if check_content_type(request) == FORM_TYPE:
        limits = {"max_files": 1, "max_fields": len(FIELDS), "max_part_size": MAX_FIELD_BYTES}
        async with request.form(**limits) as form:
            encode_request, priority = _encode_request([*query, *form.multi_items()], settings)
            image = form.get(IMAGE_FIELD)
            if not isinstance(image, UploadFile):
                raise ProblemError(422, f"the field {IMAGE_FIELD} is missing, or is not a file")
            yield Submission(encode_request, priority, image)
    else:
        encode_request, priority = _encode_request(query, settings)
        async with body_as_file(request, settings.max_upload_bytes) as image:
            yield Submission(encode_request, priority, image)


def new_job(submitted: Submission, header: SourceImage, image: bytes, key: str | None, owner: str | None) -> NewJob:
    """The job to accept."""
    asked = {"encode": asdict(submitted.request), "priority": submitted.priority}
    digest = hashlib.sha256(json.dumps(asked).encode())
    digest.update(image)
    return NewJob(new_job_id(), submitted.request, header, digest.hexdigest(), key, owner, submitted.priority)


async def read_header(submitted: Submission, work: Work, client: str, max_bytes: int) -> SourceImage:
    """What the image's header says; no pixel is decoded.

    Raises ProblemError 413, 415 for what is none of the formats, 422 for a damaged header or a size beyond the limits,
    429, 503.
    """
    size = submitted.image.size or 0
    if size > max_bytes:
        raise ProblemError(413, f"the image is larger than {max_bytes} bytes", max_bytes=max_bytes)
    try:
        return await work.read_header(client, submitted.image.file, size)
    except RefusedError as error:
        await submitted.image.seek(0)
        first = await submitted.image.read(FORMAT_BYTES)
        raise ProblemError(422 if is_read(first) or not first else 415, str(error)) from error
    except HelperError as error:
        raise ProblemError(422, f"the image's header cannot be read: {error}") from error


def _encode_request(
    given: Sequence[tuple[str, UploadFile | str]], settings: Settings
) -> tuple[EncodeRequest, Priority]:
    """What the fields ask for, from the query and the form alike. Raises ProblemError 422."""
    fields = _text_fields(given)
    budget = _budget(fields)
    time_limit_s = _time_limit_s(fields, settings.max_time_limit_s)
    profile = _profile(fields)
    tune = _tune(fields, profile, budget)
    return EncodeRequest(budget.kind, budget.value, profile, time_limit_s, tune), _priority(fields)


def _text_fields(given: Sequence[tuple[str, UploadFile | str]]) -> dict[str, str]:
    fields: dict[str, str] = {}
    for name, value in given:
        if name == IMAGE_FIELD:
            continue
        if name not in FIELDS:
            raise ProblemError(422, f"unknown field {name!r}; the fields are {IMAGE_FIELD}, {', '.join(FIELDS)}")
        if name in fields:
            raise ProblemError(422, f"the field {name} is given twice")
        if not isinstance(value, str):
            raise ProblemError(422, f"the field {name} must be text, not a file")
        fields[name] = value
    return fields


def _number(name: str, text: str) -> float:
    if _NUMBER.fullmatch(text) is None:
        raise ProblemError(422, f"{name} must be a number, got {text!r}")
    return float(text)


def _budget(fields: dict[str, str]) -> Budget:
    kinds = [kind for kind in BUDGET_KINDS if kind in fields]
    if len(kinds) > 1:
        raise ProblemError(422, f"give one of {', '.join(BUDGET_KINDS)}; got {len(kinds)}")
    if not kinds:
        return DEFAULT_BUDGET
    try:
        return Budget(kinds[0], _number(kinds[0], fields[kinds[0]]))
    except BudgetError as error:
        raise ProblemError(422, str(error)) from error


def _profile(fields: dict[str, str]) -> str:
    profile = fields.get("profile", DEFAULT_PROFILE)
    if profile not in PROFILE_NAMES:
        raise ProblemError(422, f"unknown profile {profile!r}; use one of {', '.join(PROFILE_NAMES)}")
    return profile


def _tune(fields: dict[str, str], profile: str, budget: Budget) -> Tune:
    try:
        return tuning(fields.get("tune"), profile, budget)
    except BudgetError as error:
        raise ProblemError(422, str(error)) from error


def _priority(fields: dict[str, str]) -> Priority:
    name = fields.get("priority", PRIORITIES[0])
    for priority in PRIORITIES:
        if priority == name:
            return priority
    raise ProblemError(422, f"unknown priority {name!r}; use one of {', '.join(PRIORITIES)}")


def _time_limit_s(fields: dict[str, str], most_s: float) -> float:
    if "time_limit_s" not in fields:
        return most_s
    seconds = _number("time_limit_s", fields["time_limit_s"])
    if not (math.isfinite(seconds) and 0 < seconds <= most_s):
        raise ProblemError(422, f"time_limit_s must be more than 0 and at most {most_s:g}")
    return seconds
