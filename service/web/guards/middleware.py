"""What stands before the application: limits on the bodies of requests and answers, and headers on every answer.

The server does not limit how large or how slow a body is, and the framework reads the whole of it before it looks at
anything else. So both limits hold here, while the bytes come in. Neither of them limits how much of the answers waits
in memory for slow clients; that limit is here too.
"""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.web.guards.problems import ProblemError, refused
from service.web.guards.shares import Shares, client_of
from service.web.guards.turns import Pace

# A connection that is closed while its client still writes is reset, and the client never sees the
# answer. So after an early answer the rest of the body is read and dropped, for a while.
LINGER_S = 2.0
PIECE_BYTES = 1 << 18  # of an answer that are handed over at once

# A request takes the loop about 2 ms, and has to wait for every other that has begun. A client without company gains
# nothing from more.
BEGUN_AT_ONCE = 16
MOMENT_S = 0.1
MOST_WAITING = 200

STRICT_POLICY = "default-src 'none'; frame-ancestors 'none'"
RESPONSE_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Content-Security-Policy": STRICT_POLICY,
}


@dataclass(frozen=True)
class BodyLimits:
    """max_bytes, timeout_s: of one request body; chunk_timeout_s: seconds between two of its chunks.

    min_rate: bytes a second that a body must bring on average, with chunk_timeout_s on top.
    """

    max_bytes: int
    chunk_timeout_s: float
    timeout_s: float
    min_rate: int


class BodyGuard:
    """Middleware: reading a body beyond the limits raises ProblemError 413, 408, 429 or 503 in the application.

    uploads: bodies that come in at once.
    """

    def __init__(self, app: ASGIApp, limits: BodyLimits, uploads: Shares) -> None:
        self._app = app
        self._limits = limits
        self._uploads = uploads

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        exchange = _Exchange(scope, self._limits, receive, send, self._uploads)
        try:
            await self._app(scope, exchange.receive, exchange.send)
        finally:
            exchange.give_back()


class _Exchange:
    """One request and its answer."""

    def __init__(self, scope: Scope, limits: BodyLimits, receive: Receive, send: Send, uploads: Shares) -> None:
        headers = Headers(scope=scope)
        length = headers.get("content-length", "0")
        self._declared = int(length) if length.isdecimal() else 0
        self._unread = self._declared > 0 or "transfer-encoding" in headers
        self._limits = limits
        self._receive = receive
        self._send = send
        self._bytes = 0
        self._started: float | None = None
        self._scope = scope
        self._uploads = uploads
        self._taken_by: str | None = None

    async def receive(self) -> Message:
        if not self._unread:
            return await self._receive()
        if self._declared > self._limits.max_bytes:
            raise self._too_large()
        if self._taken_by is None:
            client = client_of(self._scope)
            self._uploads.check(client)
            self._uploads.take(client)
            self._taken_by = client
        message = await self._in_time()
        self._bytes += len(message.get("body", b""))
        self._unread = message.get("more_body", False)
        if not self._unread:
            self.give_back()
        if self._bytes > self._limits.max_bytes:
            raise self._too_large()
        return message

    def give_back(self) -> None:
        """Its share of the uploads, when the body is in or nobody reads it any more."""
        if self._taken_by is not None:
            self._uploads.give_back(self._taken_by)
            self._taken_by = None

    async def _in_time(self) -> Message:
        now = time.monotonic()
        if self._started is None:
            self._started = now
        limits = self._limits
        allowed_s = min(limits.timeout_s, limits.chunk_timeout_s + self._bytes / limits.min_rate)
        timeout_s = min(limits.chunk_timeout_s, self._started + allowed_s - now)
        try:
            return await asyncio.wait_for(self._receive(), timeout_s)
        except TimeoutError:
            raise ProblemError(408, "the request body arrived too slowly") from None

    def _too_large(self) -> ProblemError:
        limit = self._limits.max_bytes
        return ProblemError(413, f"the body is larger than {limit} bytes", max_bytes=limit)

    async def send(self, message: Message) -> None:
        if not self._unread:
            await self._send(message)
            return
        if message["type"] == "http.response.start":
            headers = MutableHeaders(raw=list(message["headers"]))
            headers["Connection"] = "close"
            await self._send({**message, "headers": headers.raw})
        elif message.get("more_body", False):
            await self._send(message)
        else:
            await self._send({**message, "more_body": True})
            await self._linger()
            await self._send({"type": "http.response.body", "body": b"", "more_body": False})

    async def _linger(self) -> None:
        try:
            async with asyncio.timeout(LINGER_S):
                while self._unread:
                    message = await self._receive()
                    self._unread = message.get("more_body", False)
        except TimeoutError:
            return


class HeadAsGet:
    """Middleware: whatever can be got answers HEAD too; the server sends no body. Streams of events do not end, so not
    they."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["method"] == "HEAD" and not scope["path"].endswith("/events"):
            # A range is of GET alone (RFC 9110, 14.2).
            headers = [header for header in scope["headers"] if header[0] != b"range"]
            scope = {**scope, "method": "GET", "headers": headers}
        await self._app(scope, receive, send)


class PacedRequests:
    """Middleware: of one client, few requests begin at once, so that those of others come in between; too many at once
    get 429."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._pace = Pace(BEGUN_AT_ONCE, MOMENT_S, MOST_WAITING)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            async with self._pace.turn(client_of(scope)):
                await self._app(scope, receive, send)
        except ProblemError as problem:  # of the line: the application answers with its own
            await refused(Request(scope), problem)(scope, receive, send)


class WithoutPrefix:
    """Middleware: the path of a request without the prefix under which a proxy shows the service, if it is still there.

    All within know the paths that the service has by itself; answers alone name the prefix.
    """

    def __init__(self, app: ASGIApp, prefix: str) -> None:
        self._app = app
        self._prefix = prefix

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["path"].startswith(f"{self._prefix}/"):
            scope = {**scope, "path": scope["path"].removeprefix(self._prefix)}
        await self._app(scope, receive, send)


class AnswerGuard:
    """Middleware: hands large answers over piece by piece, as fast as clients take them.

    outflow: bytes that are on their way.
    """

    def __init__(self, app: ASGIApp, outflow: Shares) -> None:
        self._app = app
        self._outflow = outflow

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_in_pieces(message: Message) -> None:
            body = message.get("body", b"")
            if len(body) <= PIECE_BYTES:
                await send(message)
                return
            with self._outflow.taken(client_of(scope), len(body)):
                for start in range(0, len(body), PIECE_BYTES):
                    more = start + PIECE_BYTES < len(body) or message.get("more_body", False)
                    await send({**message, "body": body[start : start + PIECE_BYTES], "more_body": more})

        await self._app(scope, receive, send_in_pieces)


class ResponseHeaders:
    """Middleware: RESPONSE_HEADERS on every answer that does not set them itself."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(raw=list(message["headers"]))
                for name, value in RESPONSE_HEADERS.items():
                    headers.setdefault(name, value)
                message = {**message, "headers": headers.raw}
            await send(message)

        await self._app(scope, receive, send_with_headers)
