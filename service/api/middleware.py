"""Middleware for HTTP requests: their log, and the limit on bodies."""

from __future__ import annotations

import asyncio
import logging
import re
import secrets
import shutil
import tempfile
import time
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

from anyio import to_thread
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.gate import SAFE_METHODS, address_of
from service.api.metrics import Metrics
from service.api.problems import REFUSAL, RETRY_AFTER, ProblemError, refused
from service.api.requests import IN_MEMORY_BYTES
from service.logs import FIELDS, request_id

log = logging.getLogger("access")

ID_HEADER = "X-Request-Id"
RESPONSE_HEADERS = {  # defaults
    "Cache-Control": "no-cache",  # a browser would show the page and the decoder of before an upgrade
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
}
# Probes, and what clients ask again and again while they wait: seven in ten lines of a bulk run.
OFTEN = frozenset({"/livez", "/readyz", "/metrics", "/jobs/{job_id}"})
COPIES = 2  # of an upload: the temporary file, and what the storage keeps
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
        except asyncio.CancelledError:  # by the server, when a stop has waited long enough
            if not status:
                problem = ProblemError(503, "the service is stopping", reason="stop", headers=RETRY_AFTER)
                await refused(scope, problem)(scope, receive, note)
        finally:
            ms = 1000 * (time.monotonic() - started)
            fields = {"method": method, "path": path[:MAX_LOGGED_PATH], "status": status, "ms": round(ms, 1)}
            fields |= {"bytes": size, "address": address_of(scope.get("client"))}
            who = {"key": state["caller"].owner if "caller" in state else None, REFUSAL: state.get(REFUSAL)}
            fields |= {name: value for name, value in who.items() if value}
            _log_request(fields, getattr(scope.get("route"), "path", ""))
            request_id.reset(token)


def _log_request(fields: Mapping[str, Any], route: str) -> None:
    """Log a request: one of OFTEN that went well at level debug, any other at level info."""
    often = route in OFTEN and fields["method"] in SAFE_METHODS and fields["status"] < HTTPStatus.BAD_REQUEST
    what = "{method} {path!a} {status} {ms:.1f} ms {bytes} bytes, {address}".format_map(fields)
    key = f" key {fields['key']}" if "key" in fields else ""
    words = f"{what}{key} {fields.get(REFUSAL, '')}".rstrip()
    log.log(logging.DEBUG if often else logging.INFO, "%s", words, extra={FIELDS: fields})


class BodyLimit:
    """Middleware that raises ProblemError in the application when it reads a body that is too large for it or the disk.

    413 for more than max_bytes; 503, before the first byte, if the disk of temporary files has no room for what the
    client announces, or for max_bytes if it announces nothing. min_free_bytes: left free for the job table and for jobs
    that have been accepted.
    """

    def __init__(self, app: ASGIApp, max_bytes: int, min_free_bytes: int) -> None:
        self._app = app
        self._max_bytes = max_bytes
        self._min_free_bytes = min_free_bytes
        self._reserved = 0  # bytes that are still to be written

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope)
        # The server refuses what is no number below 2 ** 64, but takes any number of zeros before it.
        declared, received = int(headers.get("content-length", "").lstrip("0") or 0), 0
        expected = self._max_bytes if "transfer-encoding" in headers else declared
        needed, reserved = COPIES * expected if expected > IN_MEMORY_BYTES else 0, 0  # bytes of the disk

        async def limited() -> Message:
            nonlocal needed, received, reserved
            self._check(declared)
            if needed:
                await self._reserve(needed)
                needed, reserved = 0, needed
            message = await receive()
            size = len(message.get("body", b""))
            received += size
            self._check(received)
            written = min(size, reserved)  # which the free space lacks from now on
            reserved -= written
            self._reserved -= written
            return message

        try:
            await self._app(scope, limited, send)
        finally:
            self._reserved -= reserved

    def _check(self, size: int) -> None:
        if size > self._max_bytes:
            detail = f"the body is larger than {self._max_bytes} bytes"
            raise ProblemError(413, detail, max_bytes=self._max_bytes)

    async def _reserve(self, size: int) -> None:
        """Reserve disk space. Raises ProblemError 503 if there is too little."""
        usage = await to_thread.run_sync(shutil.disk_usage, tempfile.gettempdir())
        if usage.free - self._reserved - size < self._min_free_bytes:
            detail = "the disk has no room for this upload, with those that are on their way"
            raise ProblemError(503, detail, reason="disk", headers=RETRY_AFTER)
        self._reserved += size
