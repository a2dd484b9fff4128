"""Limits on connections and on the heads of requests, which the server itself does not set."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any

import httptools
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from service.web.guards import access
from service.web.guards.addresses import UNKNOWN, Network, address_of, is_within
from service.web.guards.crowd import Crowd
from service.web.guards.metrics import Metrics
from service.web.guards.problems import MEDIA_TYPE, ProblemError, problem_document

BETWEEN_REQUESTS, IN_HEAD, IN_BODY = range(3)
FRAMING = frozenset({b"content-length", b"transfer-encoding"})  # headers that tell where a body ends


@dataclass(frozen=True)
class ConnectionLimits:
    """most: connections at once; most_of_one: of one address; trusted: networks of proxies, which stand for many
    clients; head_bytes, head_timeout_s: of a request line with its headers;
    send_timeout_s: for how long a client may leave an answer, or a piece of a large one, untaken.
    """

    most: int
    most_of_one: int
    trusted: Sequence[Network]
    head_bytes: int
    head_timeout_s: float
    send_timeout_s: float


def limited_connections(limits: ConnectionLimits, metrics: Metrics) -> type[asyncio.Protocol]:
    """The protocol for uvicorn; metrics: count what is refused here, before the application knows of it."""

    class LimitedConnection(_Connection):
        LIMITS = limits
        METRICS = metrics
        CROWD = Crowd()

    return LimitedConnection


class _Connection(HttpToolsProtocol):
    LIMITS: ConnectionLimits
    METRICS: Metrics
    CROWD: Crowd[_Connection]

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._place = BETWEEN_REQUESTS
        self._address = UNKNOWN
        self._head_bytes = 0
        self._offers_upgrade = False  # the request whose head was read last
        self._head_is_known = False  # and is read again, without the offer
        self._head_timer: asyncio.TimerHandle | None = None
        self._send_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._address = address_of(transport.get_extra_info("peername"))
        if not self._find_room():
            return
        # What the system has taken over of an answer is out of sight here. So the system itself ends a connection whose
        # peer acknowledges nothing, or keeps its window shut, for so long.
        raw = transport.get_extra_info("socket")
        if raw is not None and raw.family != socket.AF_UNIX:
            milliseconds = int(1000 * self.LIMITS.send_timeout_s)
            raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, milliseconds)
        self._start_timer()

    def _find_room(self) -> bool:
        """Close the connection that has been slowest to ask for something, if there are too many; refuse this one if
        all are being answered. An address that has too many makes room among its own.
        """
        address, crowd = self._address, self.CROWD
        one = address != UNKNOWN and not is_within(address, self.LIMITS.trusted)
        if one and crowd.size(address) >= self.LIMITS.most_of_one and not self._close(crowd.quietest(address)):
            detail = "too many connections from this address"
            self._refuse(ProblemError(429, detail, reason="own_connections"))
            return False
        if crowd.size() >= self.LIMITS.most and not self._close(crowd.quietest()):
            self._refuse(ProblemError(503, "there are too many connections", reason="connections"))
            return False
        crowd.enter(self, address)
        return True

    def _close(self, slowest: _Connection | None) -> bool:
        """False if there is none that nothing is lost with."""
        if slowest is None:
            return False
        self.CROWD.leave(slowest)  # at once: the loop says that it is lost after others have come
        slowest.transport.close()
        return True

    def _rest_if_answered(self) -> None:
        if self._place != IN_BODY and self.cycle.response_complete:
            self.CROWD.rest(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self.CROWD.leave(self)
        self._stop_timer()
        super().connection_lost(exc)  # which resumes writing

    def pause_writing(self) -> None:
        super().pause_writing()
        self._send_timer = self.loop.call_later(self.LIMITS.send_timeout_s, self.transport.abort)

    def resume_writing(self) -> None:
        if self._send_timer is not None:
            self._send_timer.cancel()
            self._send_timer = None
        super().resume_writing()

    def data_received(self, data: bytes) -> None:
        if self.transport.is_closing():
            return
        if self._place == BETWEEN_REQUESTS and not data.strip(b"\r\n"):
            return  # allowed between requests, and must not count as a sign of life
        self._unset_keepalive_if_required()
        while data and not self.transport.is_closing():
            length = len(data)
            try:
                self.parser.feed_data(data)
            except httptools.HttpParserError:
                self._refuse_unless_closing(ProblemError(400, "this is not HTTP/1.1"))
            except httptools.HttpParserUpgrade as offer:
                length = offer.args[0]
                self._leave_offer()
            if self._place == IN_HEAD:
                self._count(length)
            data = data[length:]

    def _leave_offer(self) -> None:
        """Take what follows the head for its body, and then for further requests, as RFC 9110 allows in 7.8.

        The parser takes it for another protocol as soon as the head offers one. The server by itself drops the body, or
        takes it for a request: what a client of Java's posts without further ado never arrived.
        """
        framing = [b"%b: %b\r\n" % header for header in self.headers if header[0] in FRAMING]
        self.parser = httptools.HttpRequestParser(self)
        self.parser.set_dangerous_leniencies(lenient_data_after_close=True)  # as the server's own
        self._head_is_known, self._offers_upgrade = True, False
        self.parser.feed_data(b"POST / HTTP/1.1\r\n" + b"".join(framing) + b"\r\n")
        self._head_is_known = False

    def on_message_begin(self) -> None:
        if self._head_is_known:
            return
        super().on_message_begin()
        self._place, self._head_bytes = IN_HEAD, 0
        if self._head_timer is None:
            self._start_timer()

    def on_url(self, url: bytes) -> None:
        if self._head_is_known:
            return
        super().on_url(url)
        self._count(len(url))

    def on_header(self, name: bytes, value: bytes) -> None:
        if self._head_is_known:
            return
        super().on_header(name, value)
        self._count(len(name) + len(value))

    def on_headers_complete(self) -> None:
        if self._head_is_known:
            return
        self._stop_timer()
        self._place, self._offers_upgrade = IN_BODY, self.parser.should_upgrade()
        self.CROWD.stir(self)
        if self._offers_upgrade and self._get_upgrade() == b"websocket":  # RFC 6455, 4.2.2
            self._refuse_unless_closing(ProblemError(404, "there are no WebSockets here", reason="websocket"))
        if not self.transport.is_closing():
            super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        if not self.transport.is_closing():
            super().on_body(body)

    def on_message_complete(self) -> None:
        if self._offers_upgrade:
            return  # the body is still to come
        self._place = BETWEEN_REQUESTS
        if not self.transport.is_closing():
            super().on_message_complete()
            self._rest_if_answered()

    def on_response_complete(self) -> None:
        super().on_response_complete()  # which may begin to answer the next request
        self._rest_if_answered()

    def _count(self, head_bytes: int) -> None:
        self._head_bytes += head_bytes
        if self._head_bytes > self.LIMITS.head_bytes:
            limit = f"the request line and headers are larger than {self.LIMITS.head_bytes} bytes"
            self._refuse_unless_closing(ProblemError(431, limit))

    def _start_timer(self) -> None:
        self._head_timer = self.loop.call_later(self.LIMITS.head_timeout_s, self._head_is_late)

    def _stop_timer(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None

    def _head_is_late(self) -> None:
        self._head_timer = None
        if self._place == IN_HEAD:
            self._refuse(ProblemError(408, "the headers came too slowly"))
        else:
            self.transport.close()

    def _refuse_unless_closing(self, problem: ProblemError) -> None:
        if not self.transport.is_closing():
            self._refuse(problem)

    def _refuse(self, problem: ProblemError) -> None:
        """Close, with an answer unless one to an earlier request is still on its way."""
        self.METRICS.refusals.labels(problem.reason).inc()
        if self.cycle is not None and not self.cycle.response_complete:
            self.transport.close()
            return
        name = access.new_id()
        access.log_refusal(name, problem.status, self._address, problem.reason)
        body = json.dumps(problem_document(problem)).encode()
        head = (
            f"HTTP/1.1 {problem.status} {HTTPStatus(problem.status).phrase}\r\nContent-Type: {MEDIA_TYPE}\r\n"
            f"Content-Length: {len(body)}\r\n{access.HEADER}: {name}\r\n"
            "X-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n"
        )
        self.transport.write(head.encode() + body)
        self.transport.close()
