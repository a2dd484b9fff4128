"""What stands before the application: a limit on the bodies of requests, and headers on every answer."""

from __future__ import annotations

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.web.guards.problems import ProblemError

STRICT_POLICY = "default-src 'none'; frame-ancestors 'none'"
RESPONSE_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Content-Security-Policy": STRICT_POLICY,
}


class BodyLimit:
    """Middleware: reading a body of more than max_bytes raises ProblemError 413 in the application."""

    def __init__(self, app: ASGIApp, max_bytes: int) -> None:
        self._app = app
        self._max_bytes = max_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        length = Headers(scope=scope).get("content-length", "0")
        declared, received = int(length) if length.isdecimal() else 0, 0

        async def limited() -> Message:
            nonlocal received
            message = await receive() if declared <= self._max_bytes else {}
            received += len(message.get("body", b""))
            if max(declared, received) > self._max_bytes:
                detail = f"the body is larger than {self._max_bytes} bytes"
                raise ProblemError(413, detail, max_bytes=self._max_bytes)
            return message

        await self._app(scope, limited, send)


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
