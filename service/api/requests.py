"""Reading of requests: headers, bodies, and whether clients are still connected."""

from __future__ import annotations

import asyncio
import os
import re
import shutil
import tempfile
from collections.abc import AsyncIterator, Coroutine
from contextlib import ExitStack, asynccontextmanager
from typing import Annotated, Any, BinaryIO, TypeVar

from anyio import to_thread
from fastapi import Query, Request
from pydantic import BaseModel, ConfigDict
from starlette.datastructures import Headers, UploadFile
from starlette.requests import ClientDisconnect

from service.api.problems import ProblemError
from service.pictures import MEDIA_TYPES, PictureFormat

BITSTREAM_TYPE = "application/octet-stream"
FORM_TYPE = "multipart/form-data"
IN_MEMORY_BYTES = 1 << 20  # of a body; larger ones go to a temporary file
# Headers of answers.
VARIES = {"Vary": "Accept"}
NEVER_STORED = {"Cache-Control": "no-store"}

IMAGE_FIELD, WAIT_FIELD = "image", "wait"  # all other fields are options
MAX_FIELDS, MAX_FIELD_BYTES = 20, 1 << 10  # limits of a form; its parser reports them in kB
MAX_WAIT_S = 50  # by default, proxies give up on an answer that has not begun after 60 s

_WEIGHT = re.compile(r"[01](\.[0-9]{0,3})?|\.[0-9]{1,3}")
_IDEMPOTENCY_KEY = re.compile(r"[!-~]{1,255}")
T = TypeVar("T")
Field = tuple[str, str]
Wait = Annotated[
    int,
    Query(
        ge=0,
        le=999_999,
        description=f"seconds to wait for the file; 202 after that, and after {MAX_WAIT_S} seconds at the latest",
    ),
]


class Parameters(BaseModel):
    """Query parameters. Unknown ones are refused: a misspelt one would be ignored, and the answer cached for long."""

    model_config = ConfigDict(extra="forbid")


def header_line(headers: Headers, name: str) -> str | None:
    """Join all lines of a header (RFC 9110, 5.3). Returns None if there are none."""
    lines = headers.getlist(name)
    return ", ".join(lines) if lines else None


def media_type(request: Request) -> str:
    """Return the body's media type; empty if none is given. Raises ProblemError 415 if there are several."""
    given = set(request.headers.getlist("content-type"))
    if len(given) > 1:
        raise ProblemError(415, "the request has more than one Content-Type")
    return "".join(given).partition(";")[0].strip().lower()


def accepted_format(request: Request) -> PictureFormat:
    """Return the format that the Accept header prefers; PNG without a preference. Raises ProblemError 406."""
    accept = header_line(request.headers, "accept") or "*/*"
    weights: dict[str, float] = {}
    for entry in accept.split(","):
        name, *parameters = (part.strip().lower() for part in entry.split(";"))
        given = next((p[2:] for p in parameters if p.startswith("q=")), "1")
        weights[name] = float(given) if _WEIGHT.fullmatch(given) else 1.0
    best: PictureFormat = "png"
    best_weight = 0.0
    for kind, own_type in MEDIA_TYPES.items():  # PNG comes first
        weight = next((weights[name] for name in (own_type, "image/*", "*/*") if name in weights), 0.0)
        if weight > best_weight:
            best, best_weight = kind, weight
    if best_weight == 0:
        raise ProblemError(406, f"pictures are available as {', '.join(MEDIA_TYPES.values())}", headers=VARIES)
    return best


def picture_kind(request: Request) -> PictureFormat | None:
    """Return the picture format that the Accept header asks for; None for a bitstream. Raises ProblemError 406."""
    accept = (header_line(request.headers, "accept") or "").lower()
    return accepted_format(request) if "image/" in accept and BITSTREAM_TYPE not in accept else None


def idempotency_key(request: Request) -> str | None:
    """Return the Idempotency-Key. Raises ProblemError 400."""
    key = header_line(request.headers, "idempotency-key")
    if key is not None and _IDEMPOTENCY_KEY.fullmatch(key) is None:
        raise ProblemError(400, "Idempotency-Key must be 1 to 255 visible ASCII characters")
    return key


@asynccontextmanager
async def body_as_file(request: Request) -> AsyncIterator[UploadFile]:
    """Read the whole body into a file, deleted at the end of the context. Raises ProblemError, from BodyLimit.

    A small one is in memory, and yet has a descriptor for the sandbox: a full disk does not keep it from being decoded.
    """
    upload = UploadFile(os.fdopen(os.memfd_create("body"), "w+b"), size=0)
    try:
        async for chunk in request.stream():
            size = upload.size or 0
            if size <= IN_MEMORY_BYTES < size + len(chunk):
                upload.file = await to_thread.run_sync(_on_disk, upload.file)
            await upload.write(chunk)
        await upload.seek(0)
        yield upload
    finally:
        await upload.close()


def _on_disk(file: BinaryIO) -> BinaryIO:
    """Move a file from memory to a temporary file, and close it."""
    with file, ExitStack() as stack:
        moved = stack.enter_context(tempfile.TemporaryFile())
        file.seek(0)
        shutil.copyfileobj(file, moved)
        stack.pop_all()
    return moved


@asynccontextmanager
async def image_and_fields(request: Request) -> AsyncIterator[tuple[UploadFile, list[Field]]]:
    """Read the image of POST /encode, and the other fields in its query and form.

    A body that is not a form is the image itself. Large bodies go to temporary files, deleted at the end of the
    context. Raises ProblemError 413 or 422, or HTTPException 400 for a malformed form.
    """
    in_query = [(name, value) for name, value in request.query_params.multi_items() if name != WAIT_FIELD]
    if media_type(request) != FORM_TYPE:
        async with body_as_file(request) as image:
            yield image, in_query
        return
    async with request.form(max_files=1, max_fields=MAX_FIELDS, max_part_size=MAX_FIELD_BYTES) as form:
        images = form.getlist(IMAGE_FIELD)
        if len(images) != 1 or not isinstance(images[0], UploadFile):
            raise ProblemError(422, f"the field {IMAGE_FIELD} is missing, is not a file, or is given twice")
        # Only one file is allowed, and that is the image, so the others are texts.
        texts = [(name, str(value)) for name, value in form.multi_items() if name != IMAGE_FIELD]
        yield images[0], in_query + texts


async def no_body(request: Request) -> None:
    """Raise ProblemError 422 if there is a body, which would otherwise be ignored in silence."""
    async for chunk in request.stream():
        if chunk:
            raise ProblemError(422, "this request takes no body; its parameters are in the query")


async def while_client_waits(request: Request, work: Coroutine[Any, Any, T]) -> T:
    """Return the result of work once the body is read; a disconnect cancels it. Raises ClientDisconnect."""
    working = asyncio.create_task(work)
    tasks = working, asyncio.create_task(_disconnected(request))
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        if working.done():
            return working.result()
        raise ClientDisconnect
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _disconnected(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass
