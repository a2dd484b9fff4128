"""A line for each request, and an id by which to find everything that was logged for it."""

from __future__ import annotations

import logging
import re
import secrets
import time

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.logs import FIGURES, request_id
from service.web.guards.problems import REFUSAL

log = logging.getLogger("access")

HEADER = "X-Request-Id"
_GIVEN = re.compile(r"[A-Za-z0-9_.-]{1,64}")


def new_id() -> str:
    """An id for a request that came without one."""
    return secrets.token_hex(8)


class AccessLog:
    """Middleware: takes over the client's X-Request-Id or makes one, and logs the request when its answer has gone.

    Queries are left out: they may hold the signature of a link.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        given = Headers(scope=scope).get(HEADER, "")
        name = given if _GIVEN.fullmatch(given) else new_id()
        status, size, started = 0, 0, time.monotonic()

        async def note(message: Message) -> None:
            nonlocal status, size
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(raw=list(message["headers"]))
                headers[HEADER] = name
                message = {**message, "headers": headers.raw}
            size += len(message.get("body", b""))
            await send(message)

        token = request_id.set(name)
        try:
            await self._app(scope, receive, note)
        finally:
            state = scope.get("state", {})
            caller = state.get("caller")
            figures = {
                "method": scope["method"],
                "path": scope["path"],
                "status": status,
                "ms": round(1000 * (time.monotonic() - started), 1),
                "bytes": size,
                "client": caller.client if caller else "",
                "refusal": state.get(REFUSAL, ""),
            }
            words = "{method} {path!a} {status} {ms} ms {bytes} bytes, {client} {refusal}".format(**figures)
            log.info("%s", words.rstrip(), extra={FIGURES: figures})
            request_id.reset(token)
