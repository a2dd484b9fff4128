"""Answers with files: sent in parts as clients read them, and kept by clients until they expire (ETag, 304)."""

from __future__ import annotations

import time
from collections.abc import Callable, Coroutine, Mapping
from email.utils import formatdate
from typing import Any

from fastapi import Request, Response
from starlette.types import Receive, Scope, Send

from service.api.context import Call
from service.api.requests import IN_MEMORY_BYTES, while_client_waits
from service.jobs.job import Job
from service.pictures import MEDIA_TYPES, PictureFormat
from service.settings import Settings

MAX_CACHED_S = 31_536_000  # a year, the most that RFC 2616 allowed
PART_BYTES = 1 << 18


class FileResponse(Response):
    """A file in memory, sent in parts as its client reads.

    Until the last part, its bytes count as unread. Raises ProblemError 503 or 429 for a large one if too many are.
    """

    def __init__(self, call: Call, file: bytes, headers: Mapping[str, str], media_type: str) -> None:
        self._unread, self._client = call.context.unread, call.caller.client
        if len(file) > IN_MEMORY_BYTES:
            self._unread.refuse_if_full(self._client, "files", "waiting to be read")
        super().__init__(file, headers=dict(headers), media_type=media_type)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        with self._unread.hold(self._client, len(self.body)):
            await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
            rest = memoryview(self.body)
            while len(rest) > PART_BYTES:
                await send({"type": "http.response.body", "body": rest[:PART_BYTES], "more_body": True})
                rest = rest[PART_BYTES:]
            await send({"type": "http.response.body", "body": rest})


async def cached_picture(
    call: Call, headers: Mapping[str, str], kind: PictureFormat, make: Callable[[], Coroutine[Any, Any, bytes]]
) -> Response:
    """Answer with the picture that the ETag names: 304 if the client has it; else from the cache, or from `make`."""
    if (answer := not_modified(call.request, headers)) is not None:
        return answer
    pictures = call.context.pictures
    file = pictures.get(headers["ETag"])
    if file is None:
        file = await while_client_waits(call.request, make())
        pictures.put(headers["ETag"], file)
    return FileResponse(call, file, headers, MEDIA_TYPES[kind])


def not_modified(request: Request, headers: Mapping[str, str]) -> Response | None:
    """Return 304 if the client has the file with this ETag (RFC 9110, 13.1.2)."""
    given = request.headers.getlist("if-none-match") if request.method == "GET" else []
    known = [tag.strip().removeprefix("W/") for tag in ",".join(given).split(",")]
    if "*" not in known and headers["ETag"] not in known:
        return None
    kept = {name: value for name, value in headers.items() if name != "Content-Disposition"}
    return Response(status_code=304, headers=kept)


def cache_headers(call: Call, job: Job, etag: str, image_until: float | None = None) -> dict[str, str]:
    """Return the caching headers of a file.

    A response to a link is cached no longer than the link is valid, and a file made from the image no longer than until
    image_until.
    """
    ends = [end for end in (call.caller.link_expires, image_until) if end is not None]
    max_age_s = min([MAX_CACHED_S, *(max(0, int(end - time.time())) for end in ends)])
    # Private, because the URL contains a secret id, which shared caches should not store.
    headers = {"ETag": etag, "Cache-Control": f"private, max-age={max_age_s}, immutable"}
    if (removed := removed_at(job, call.context.settings)) is not None:
        ends.append(removed)
    return {**headers, "Expires": formatdate(min(ends), usegmt=True)} if ends else headers


def removed_at(job: Job, settings: Settings) -> float | None:
    """Return when the job is removed, in seconds since 1970; None if it is not finished, or is kept for ever."""
    kept_s = settings.retention_s
    return job.finished_at + kept_s if job.finished_at is not None and kept_s else None
