"""Bodies of requests: forms, files, and where none belongs."""

from __future__ import annotations

import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import BinaryIO, cast

from starlette.datastructures import UploadFile
from starlette.requests import Request

from service.api.options import IMAGE_FIELD, OPTIONS, EncodeOptions, read_options
from service.api.problems import ProblemError
from service.api.tasks import ClientTasks
from service.jobs.job import SourceImage
from service.sandbox.client import RefusedError, TaskError
from sgmethod.io.formats import is_read

FORM_TYPE, IMAGE_TYPES = "multipart/form-data", "image/"
FORMAT_BYTES = 256  # of a file, which tell its format
MAX_FIELD_BYTES = 256
MEMORY_BYTES = 1 << 20  # of a body that is still coming in; what is larger goes to a temporary file
WAIT_FIELD = "wait"  # of the query alone


def media_type(request: Request) -> str:
    """The body's media type, empty if none is given. Raises ProblemError 415 if several are."""
    given = set(request.headers.getlist("content-type"))
    if len(given) > 1:
        raise ProblemError(415, "the request has more than one Content-Type")
    return "".join(given).partition(";")[0].strip().lower()


def image_type(request: Request) -> str:
    """The body's media type. Raises ProblemError 415 unless it is a form or an image."""
    found = media_type(request)
    if found != FORM_TYPE and not found.startswith(IMAGE_TYPES):
        accepted = f"{FORM_TYPE}, {IMAGE_TYPES}*"
        raise ProblemError(415, f"the body must be {FORM_TYPE} or an image", headers={"Accept": accepted})
    return found


def _in_query(request: Request) -> list[tuple[str, str]]:
    return [(name, value) for name, value in request.query_params.multi_items() if name != WAIT_FIELD]


@asynccontextmanager
async def image_and_options(request: Request) -> AsyncIterator[tuple[UploadFile, EncodeOptions]]:
    """The image and the options of POST /encode. What is large goes to temporary files, gone with the context.

    Entering raises ProblemError 413, 415 or 422, or HTTPException 400 on what is no form.
    """
    if image_type(request) != FORM_TYPE:
        options = read_options(_in_query(request))
        async with body_as_file(request) as image:
            yield image, options
        return
    async with request.form(max_files=1, max_fields=len(OPTIONS), max_part_size=MAX_FIELD_BYTES) as form:
        fields = [field for field in form.multi_items() if field[0] != IMAGE_FIELD]
        options = read_options([*_in_query(request), *fields])
        images = form.getlist(IMAGE_FIELD)
        if len(images) != 1 or not isinstance(images[0], UploadFile):
            raise ProblemError(422, f"the field {IMAGE_FIELD} is missing, is not a file, or is given twice")
        yield images[0], options


async def options_alone(request: Request) -> EncodeOptions:
    """The options of a request that brings no image: in the query, in a form, or in both.

    Raises ProblemError 415 or 422, or HTTPException 400 on what is no form.
    """
    if media_type(request) == FORM_TYPE and _has_body(request):
        async with request.form(max_files=0, max_fields=len(OPTIONS), max_part_size=MAX_FIELD_BYTES) as form:
            return read_options([*_in_query(request), *form.multi_items()])
    refusal = f"the fields belong in the query, or in a body of type {FORM_TYPE}"
    await _refuse_body(request, ProblemError(415, refusal, headers={"Accept": FORM_TYPE}))
    return read_options(_in_query(request))


@asynccontextmanager
async def body_as_file(request: Request) -> AsyncIterator[UploadFile]:
    """The whole body as a file, gone with the context. Raises ProblemError 413, from the limit before."""
    file = cast(BinaryIO, tempfile.SpooledTemporaryFile(MEMORY_BYTES))  # noqa: SIM115 - upload closes it
    upload = UploadFile(file, size=0)
    try:
        async for chunk in request.stream():
            await upload.write(chunk)
        await upload.seek(0)
        yield upload
    finally:
        await upload.close()


def _has_body(request: Request) -> bool:
    """Whether a body is announced, though it may be empty."""
    return request.headers.get("content-length", "0") != "0" or "transfer-encoding" in request.headers


async def _refuse_body(request: Request, refusal: ProblemError) -> None:
    """Raises the refusal if the request brings a byte: what would be ignored must not look as if it were used."""
    async for chunk in request.stream():
        if chunk:
            raise refusal


async def no_body(request: Request) -> None:
    """Raises ProblemError 422."""
    await _refuse_body(request, ProblemError(422, "this request takes no body; its parameters are in the query"))


async def read_header(image: UploadFile, tasks: ClientTasks, client: str) -> SourceImage:
    """What the image's header says; no pixel is decoded.

    Raises ProblemError 415 for what is none of the formats, 422 for a damaged header or a size beyond the limits, 429,
    503.
    """
    try:
        return await tasks.read_header(client, image.file, image.size or 0)
    except RefusedError as error:
        raise await refusal(error, image) from error
    except TaskError as error:
        raise ProblemError(422, f"the image's header cannot be read: {error}") from error


async def refusal(error: RefusedError, image: UploadFile) -> ProblemError:
    """415 for an image in none of the formats, 422 for a damaged one or a size beyond the limits."""
    await image.seek(0)
    first = await image.read(FORMAT_BYTES)
    return ProblemError(422 if is_read(first) or not first else 415, str(error))
