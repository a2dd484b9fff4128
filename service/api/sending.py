"""Answers with files, which may be large, and whose clients may read slowly."""

from __future__ import annotations

from collections.abc import Mapping

from fastapi import Request, Response
from starlette.types import Receive, Scope, Send

from service.api.context import context_of
from service.api.requests import IN_MEMORY_BYTES

PART_BYTES = 1 << 18


class FileResponse(Response):
    """A file in memory, sent in parts as its client reads.

    Until the last part, its bytes count as unread. Raises ProblemError 503 or 429 for a large one if too many are.
    """

    def __init__(self, request: Request, file: bytes, headers: Mapping[str, str], media_type: str) -> None:
        self._unread, self._client = context_of(request).unread, request.state.caller.client
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
