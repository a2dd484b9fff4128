"""The gate: each request gets an id and a line in the log, its caller is identified, and its body is limited.

A caller is refused before a byte of the body is read.
"""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import re
import secrets
import shutil
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs, urlsplit

from anyio import to_thread
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.metrics import Metrics
from service.api.problems import PAGE, REFUSAL, RETRY_AFTER, ProblemError, refused
from service.api.requests import IN_MEMORY_BYTES, header_line
from service.keys import KeyRing, Link
from service.logs import FIELDS, request_id
from service.settings import Settings, listed

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
# The page loads before a user can enter a key, and probes have none.
OPEN_PATHS = frozenset({"/", PAGE, "/livez", "/readyz", "/openapi.json"})
OPEN_PREFIX = "/static/"
METRICS, METRICS_PATH = "metrics", "/metrics"  # the owner of keys that may do nothing else, for a Prometheus
NETWORK_BITS = 64  # of an IPv6 address, which identify a customer's network
UNKNOWN = "unknown"
SAFE_METHODS = ("GET", "HEAD", "OPTIONS")
CHALLENGE = {"WWW-Authenticate": "Bearer"}

_GIVEN_ID = re.compile(r"[A-Za-z0-9_.-]{1,64}")
_LINKED_PATH = re.compile(r"/(decode|bitstreams)/([0-9a-f]{32})(\.[a-z]{2,4})?")


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


@dataclass(frozen=True)
class Caller:
    """The caller of a request. All fields but `client` are None where the service has no API keys.

    client: takes turns with other clients, the owner of a key or else an address; owner: owner of the API key;
    linked_job: the one job that a link gives access to; link_expires: seconds since 1970.
    """

    client: str
    owner: str | None = None
    linked_job: str | None = None
    link_expires: int | None = None


def address_of(peer: Sequence[object] | None) -> str:
    """Return the client's address: an IPv4 address, or the network of an IPv6 address. peer: (host, port)."""
    address = _address_in(str(peer[0])) if peer else None
    if isinstance(address, ipaddress.IPv6Address):
        mapped = address.ipv4_mapped
        address = mapped or ipaddress.ip_network((int(address), NETWORK_BITS), strict=False).network_address
    return UNKNOWN if address is None else str(address)


def _address_in(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(text)
    except ValueError:
        return None


def _name_in(host: str) -> str:
    """Return the name or address in a Host header; empty if it is malformed."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def path_of(scope: Scope) -> str:
    """Return the path without the prefix under which a proxy serves this."""
    path: str = scope["path"]
    return path.removeprefix(scope.get("root_path", ""))


def _without_link(scope: Scope) -> bytes:
    """Return the query without a link's parameters. With an API key they are ignored."""
    query: bytes = scope["query_string"]
    if _LINKED_PATH.fullmatch(path_of(scope)) is None:
        return query
    return b"&".join(part for part in query.split(b"&") if not part.startswith((b"expires=", b"signature=")))


class Authentication:
    """Middleware that identifies the caller, or refuses the request.

    Without API keys, any page in a browser on this machine could call the service. Pages of other sites are kept out:
    by the host name that they used, and by their Origin where the request would change something.
    """

    def __init__(self, app: ASGIApp, keys: KeyRing, settings: Settings) -> None:
        self._app = app
        self._keys = keys
        self._link_secret = settings.link_secret.get_secret_value()
        self._host_names = {"localhost", *listed(settings.host_names.lower())}
        self._origins = set(listed(settings.cors_origins))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            scope.setdefault("state", {})["caller"] = self._caller(scope)
            scope["query_string"] = _without_link(scope)
        except ProblemError as problem:
            await refused(scope, problem)(scope, receive, send)
            return
        await self._app(scope, receive, send)

    def _caller(self, scope: Scope) -> Caller:
        path, address = path_of(scope), address_of(scope["client"])
        if not self._keys:
            self._check_site(Headers(scope=scope), scope["method"])
        if not self._keys or path in OPEN_PATHS or path.startswith(OPEN_PREFIX):
            return Caller(address)
        scheme, _, key = (header_line(Headers(scope=scope), "authorization") or "").partition(" ")
        # A key takes precedence over a link: an unknown key fails even on a valid link.
        caller = self._key_bearer(scheme, key.strip()) if scheme else self._link_bearer(scope, address)
        if caller.owner == METRICS and path != METRICS_PATH:
            raise ProblemError(403, f"the key named {METRICS} may read {METRICS_PATH} alone", reason="key")
        return caller

    def _check_site(self, headers: Headers, method: str) -> None:
        """Raise ProblemError 421 for an unknown host name, or 403 for a change requested by another site."""
        host, origin = headers.get("host"), headers.get("origin")
        name = _name_in(host or "")
        # Simple probes use HTTP/1.0 without a Host; browsers always send one.
        if host is not None and not {"*", name} & self._host_names and _address_in(name) is None:
            raise ProblemError(421, "the service does not answer to this host name; SG_HOST_NAMES may list it")
        if method in SAFE_METHODS or origin is None or {"*", origin} & self._origins:
            return
        if origin.partition("://")[2] != host:
            raise ProblemError(403, "a page of another site may not change anything here", reason="origin")

    def _key_bearer(self, scheme: str, key: str) -> Caller:
        owner = self._keys.owner_of(key) if scheme.lower() == "bearer" else None
        if owner is None:
            raise ProblemError(401, "unknown API key", headers=CHALLENGE)
        return Caller(f"key {owner}", owner)

    def _link_bearer(self, scope: Scope, address: str) -> Caller:
        match = _LINKED_PATH.fullmatch(path_of(scope))
        query = parse_qs(scope["query_string"].decode("latin-1"))
        expires, signature = (query.get(name, [""])[0] for name in ("expires", "signature"))
        if match is None or not signature or not self._link_secret or scope["method"] not in ("GET", "HEAD"):
            raise ProblemError(401, "an API key is needed: Authorization: Bearer KEY", headers=CHALLENGE)
        link = Link(match[1], match[2], int(expires) if re.fullmatch(r"[0-9]{1,12}", expires, re.ASCII) else 0)
        if not link.is_signed(self._link_secret, signature):
            raise ProblemError(401, "this link is not valid", headers=CHALLENGE)
        if link.expires < time.time():
            raise ProblemError(401, "this link has expired", headers=CHALLENGE)
        return Caller(address, linked_job=link.job_id, link_expires=link.expires)


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
        self._reserved = 0  # bytes of the disk, of bodies that are being read

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope)
        # The server refuses what is no number below 2 ** 64, but takes any number of zeros before it.
        declared, received = int(headers.get("content-length", "").lstrip("0") or 0), 0
        expected, reserved = self._max_bytes if "transfer-encoding" in headers else declared, 0

        async def limited() -> Message:
            nonlocal received, reserved
            self._check(declared)
            if expected > IN_MEMORY_BYTES and not reserved:
                await self._reserve(COPIES * expected)
                reserved = COPIES * expected
            message = await receive()
            received += len(message.get("body", b""))
            self._check(received)
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
