"""Identify and authorise callers before a byte of the body is read."""

from __future__ import annotations

import ipaddress
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from service.api.problems import PAGE, ProblemError, refused
from service.api.requests import header_line
from service.keys import KeyRing, Link
from service.settings import Settings, listed

# The page loads before a user can enter a key, and probes have none.
OPEN_PATHS = frozenset({"/", PAGE, "/livez", "/readyz", "/openapi.json"})
OPEN_PREFIX = "/static/"
METRICS, METRICS_PATH = "metrics", "/metrics"  # the owner of keys that may do nothing else, for a Prometheus
NETWORK_BITS = 64  # of an IPv6 address, which identify a customer's network
UNKNOWN = "unknown"
SAFE_METHODS = ("GET", "HEAD", "OPTIONS")
CHALLENGE = {"WWW-Authenticate": "Bearer"}

_LINKED_PATH = re.compile(r"/(decode|bitstreams)/([0-9a-f]{32})(\.[a-z]{2,4})?")


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
