"""From the body of POST /encode to a new job. Everything is checked before the job may be accepted."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import asdict, dataclass

from starlette.datastructures import UploadFile
from starlette.requests import Request

from service.jobs.job import NewJob, SourceImage, new_job_id
from service.sandbox.client import RefusedError, TaskError
from service.settings import Settings
from service.web.guards.headers import joined
from service.web.guards.problems import ProblemError
from service.web.guards.tasks import ClientTasks
from service.web.submitting.bodies import body_as_file, has_body, refuse_body
from service.web.submitting.fields import FIELDS, IMAGE_FIELD, Asked, EncodeFields, read_fields
from sgmethod.io.formats import is_read

FORMAT_BYTES = 256  # of a file, which tell its format
WAIT_FIELD = "wait"  # of the query alone
MAX_FIELD_BYTES = 256
# What multipart adds to the image itself: boundaries, part headers, the other fields.
MULTIPART_OVERHEAD_BYTES = 16 * 1024

FORM_TYPE, IMAGE_TYPES = "multipart/form-data", "image/"

_IDEMPOTENCY_KEY = re.compile(r"[!-~]{1,255}")


def idempotency_key(request: Request) -> str | None:
    """The Idempotency-Key header. Raises ProblemError 400 if it is not 1 to 255 visible ASCII characters."""
    key = joined(request.headers, "idempotency-key")
    if key is not None and _IDEMPOTENCY_KEY.fullmatch(key) is None:
        raise ProblemError(400, "Idempotency-Key must be 1 to 255 visible ASCII characters")
    return key


@dataclass(frozen=True)
class Submission:
    """The body of POST /encode, come in whole: what is asked for, and the image as a file."""

    asked: Asked
    image: UploadFile

    async def image_bytes(self) -> bytes:
        """The image file."""
        await self.image.seek(0)
        return await self.image.read()


def fields_of_query(request: Request) -> list[tuple[str, str]]:
    """Names and values in the query that may be fields of the encode."""
    return [(name, value) for name, value in request.query_params.multi_items() if name != WAIT_FIELD]


def _media_type(request: Request) -> str:
    """The body's media type, empty if none is given. Raises ProblemError 415 if several are."""
    given = set(request.headers.getlist("content-type"))
    if len(given) > 1:
        raise ProblemError(415, "the request has more than one Content-Type")
    return "".join(given).partition(";")[0].strip().lower()


def check_content_type(request: Request) -> str:
    """The body's media type. Raises ProblemError 415 unless it is a form or an image."""
    media_type = _media_type(request)
    if media_type != FORM_TYPE and not media_type.startswith(IMAGE_TYPES):
        accepted = f"{FORM_TYPE}, {IMAGE_TYPES}*"
        raise ProblemError(415, f"the body must be {FORM_TYPE} or an image", headers={"Accept": accepted})
    return media_type


async def fields_without_image(request: Request) -> EncodeFields:
    """The fields of a request that brings no image: in the query, in a form, or in both.

    Raises ProblemError 415 or 422, or HTTPException 400 on what is no form.
    """
    query = fields_of_query(request)
    if _media_type(request) == FORM_TYPE and has_body(request):
        async with request.form(max_files=0, max_fields=len(FIELDS), max_part_size=MAX_FIELD_BYTES) as form:
            return read_fields([*query, *form.multi_items()])
    refusal = f"the fields belong in the query, or in a body of type {FORM_TYPE}"
    await refuse_body(request, ProblemError(415, refusal, headers={"Accept": FORM_TYPE}))
    return read_fields(query)


@asynccontextmanager
async def submission(request: Request, settings: Settings) -> AsyncIterator[Submission]:
    """The body, read as it comes in; what is large goes to temporary files, gone with the context.

    Entering raises ProblemError 408, 413, 415 or 422, or HTTPException 400 on what is no form.
    """
    longest_s, query = settings.max_time_limit_s, fields_of_query(request)
    if check_content_type(request) == FORM_TYPE:
        limits = {"max_files": 1, "max_fields": len(FIELDS), "max_part_size": MAX_FIELD_BYTES}
        async with request.form(**limits) as form:
            given = form.multi_items()
            asked = read_fields([*query, *(one for one in given if one[0] != IMAGE_FIELD)]).asked(longest_s)
            images = form.getlist(IMAGE_FIELD)
            if len(images) != 1 or not isinstance(images[0], UploadFile):
                raise ProblemError(422, f"the field {IMAGE_FIELD} is missing, is not a file, or is given twice")
            yield Submission(asked, images[0])
    else:
        asked = read_fields(query).asked(longest_s)
        async with body_as_file(request, settings.max_upload_bytes) as image:
            yield Submission(asked, image)


def new_job(asked: Asked, header: SourceImage, image: bytes, key: str | None, owner: str | None) -> NewJob:
    """The job to accept. Takes a while for a large image."""
    words = {"encode": asdict(asked.request), "priority": asked.priority}
    digest = hashlib.sha256(json.dumps(words).encode())
    digest.update(image)
    return NewJob(new_job_id(), asked.request, header, digest.hexdigest(), key, owner, asked.priority)


async def read_header(submitted: Submission, work: ClientTasks, client: str, max_bytes: int) -> SourceImage:
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
        raise await refusal(error, submitted.image) from error
    except TaskError as error:
        raise ProblemError(422, f"the image's header cannot be read: {error}") from error


async def refusal(error: RefusedError, image: UploadFile) -> ProblemError:
    """415 for an image in none of the formats, 422 for a damaged one or a size beyond the limits."""
    await image.seek(0)
    first = await image.read(FORMAT_BYTES)
    return ProblemError(422 if is_read(first) or not first else 415, str(error))
