"""Middleware around the application: logging of requests, and the limit on bodies."""

from __future__ import annotations

import logging
import re
import secrets
import time

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.callers import address_of
from service.api.metrics import Metrics
from service.api.problems import REFUSAL, ProblemError
from service.api.room import DiskRoom, Reservation
from service.logs import request_id

log = logging.getLogger("access")

ID_HEADER = "X-Request-Id"
RESPONSE_HEADERS = {  # defaults
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
}
MAX_LOGGED_PATH = 200  # characters of the log; our own paths are shorter
_GIVEN_ID = re.compile(r"[A-Za-z0-9_.-]{1,64}")


class RequestLog:
    """Middleware that logs and counts requests, and adds an id and security headers to responses.

    The id is the client's own if it sends one. Queries are not logged, since they may contain a link's signature.
    """

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        given = Headers(scope=scope).get(ID_HEADER, "")
        name = given if _GIVEN_ID.fullmatch(given) else secrets.token_hex(8)
        method, path, state = scope["method"], scope["path"], scope.setdefault("state", {})
        if method == "HEAD":
            scope = {**scope, "method": "GET"}  # the server sends no body
        status, size, started = 0, 0, time.monotonic()

        async def note(message: Message) -> None:
            nonlocal status, size
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(raw=list(message["headers"]))
                for header, value in RESPONSE_HEADERS.items():
                    headers.setdefault(header, value)
                headers[ID_HEADER] = name
                message = {**message, "headers": headers.raw}
                self._metrics.note({**scope, "method": method}, status, time.monotonic() - started)
            size += len(message.get("body", b""))
            await send(message)

        token = request_id.set(name)
        try:
            await self._app(scope, receive, note)
        finally:
            client = state["caller"].client if "caller" in state else address_of(scope.get("client"))
            ms = 1000 * (time.monotonic() - started)
            what = f"{method} {path[:MAX_LOGGED_PATH]!a} {status} {ms:.1f} ms {size} bytes"
            log.info("%s", f"{what}, {client} {state.get(REFUSAL, '')}".rstrip())
            request_id.reset(token)


class BodyLimit:
    """Middleware that raises ProblemError in the application when it reads a body that is too large for it or the disk.

    413 for more than max_bytes; 503, before the first byte, if the disk has no room for what the client announces, or
    for max_bytes if it announces nothing.
    """

    def __init__(self, app: ASGIApp, max_bytes: int, room: DiskRoom) -> None:
        self._app = app
        self._max_bytes = max_bytes
        self._room = room

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        length = headers.get("content-length", "0")
        declared, received = int(length) if re.fullmatch("[0-9]{1,18}", length) else 0, 0
        reservation = Reservation(self._room, self._max_bytes if "transfer-encoding" in headers else declared)

        def check(size: int) -> None:
            if size > self._max_bytes:
                detail = f"the body is larger than {self._max_bytes} bytes"
                raise ProblemError(413, detail, max_bytes=self._max_bytes)

        async def limited() -> Message:
            nonlocal received
            check(declared)
            await reservation.begin()
            message = await receive()
            size = len(message.get("body", b""))
            received += size
            check(received)
            reservation.written(size)
            return message

        try:
            await self._app(scope, limited, send)
        finally:
            reservation.end()
