"""Request bodies that are one file, not a form, and requests that take none."""

from __future__ import annotations

import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import BinaryIO, cast

from starlette.datastructures import UploadFile
from starlette.requests import Request

from service.web.guards.problems import ProblemError

MEMORY_BYTES = 1 << 20  # of a body that is still coming in; what is larger goes to a temporary file


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


def has_body(request: Request) -> bool:
    """Whether a body is announced, though it may be empty."""
    return request.headers.get("content-length", "0") != "0" or "transfer-encoding" in request.headers


async def refuse_body(request: Request, refusal: ProblemError) -> None:
    """Raises the refusal if the request brings a byte: what would be ignored must not look as if it were used."""
    async for chunk in request.stream():
        if chunk:
            raise refusal
