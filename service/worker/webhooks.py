"""Webhooks that report the end of a job, signed as in Standard Webhooks and retried until they are delivered."""

from __future__ import annotations

import base64
import hashlib
import hmac
import io
import logging
import socket
import time
import urllib.request
from http.client import HTTPConnection, HTTPException, HTTPResponse
from importlib.metadata import version
from typing import Any
from urllib.parse import urlsplit

from service.jobs.outcomes import Delivery
from service.jobs.table import JobTable

log = logging.getLogger(__name__)

POLL_S = 1.0
ANSWER_S = 10.0  # from the connection to the status and headers of the answer
USER_AGENT = f"sgmethod/{version('sgmethod')}"


def send_next(table: JobTable, address: str, secret: bytes) -> bool:
    """Send the next webhook to the address; False if none is due. secret: signing key of at least 24 bytes.

    Each address has its own thread, so that a hanging one does not block the others. Raises JobTableError.
    """
    delivery = table.due_delivery(address)
    if delivery is None:
        return False
    where = urlsplit(address).hostname  # the rest of the URL may be a secret
    try:
        _post(address, headers(secret, delivery, int(time.time())), delivery.body.encode())
    except (OSError, HTTPException, ValueError) as error:  # ValueError: an invalid proxy URL
        log.warning("job %s: webhook to %s: %s", delivery.job_id, where, error)
        return True
    table.delivered(delivery)  # if that fails, it is sent again with the same id
    log.info("job %s: webhook to %s delivered", delivery.job_id, where)
    return True


def headers(secret: bytes, delivery: Delivery, now: int) -> dict[str, str]:
    """Return the headers: an id that is the same for each try, the time in seconds since 1970, and the signature."""
    signed = hmac.new(secret, f"{delivery.job_id}.{now}.{delivery.body}".encode(), hashlib.sha256).digest()
    return {
        "Content-Type": "application/json",
        "User-Agent": USER_AGENT,  # some proxies refuse that of Python
        "webhook-id": delivery.job_id,
        "webhook-timestamp": str(now),
        "webhook-signature": f"v1,{base64.b64encode(signed).decode()}",
    }


class _NoRedirects(urllib.request.HTTPRedirectHandler):
    """Treats 3xx as a failure: only the operator decides where webhooks go."""

    def redirect_request(self, *_request: Any) -> None:
        return None


class _Reader(io.RawIOBase):
    """Reads from a socket until a deadline (monotonic seconds); the socket's own timeout is that of each read."""

    def __init__(self, connection: socket.socket, deadline: float) -> None:
        self._connection = connection
        self._deadline = deadline

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        left_s = self._deadline - time.monotonic()
        if left_s <= 0:
            raise TimeoutError(f"the answer took longer than {ANSWER_S:g} s")
        self._connection.settimeout(left_s)
        return self._connection.recv_into(buffer)


class _InTime(urllib.request.HTTPHandler, urllib.request.HTTPSHandler):
    """Opens connections whose answers must come before a deadline."""

    def __init__(self, deadline: float) -> None:
        super().__init__()
        self._deadline = deadline

    def do_open(self, http_class: Any, req: urllib.request.Request, **http_conn_args: Any) -> HTTPResponse:
        def connection(host: str, **options: Any) -> HTTPConnection:
            made: HTTPConnection = http_class(host, **options)
            made.response_class = self._answer  # type: ignore[assignment]
            return made

        return super().do_open(connection, req, **http_conn_args)

    def _answer(self, connection: socket.socket, *arguments: Any, **options: Any) -> HTTPResponse:
        answer = HTTPResponse(connection, *arguments, **options)
        answer.fp = io.BufferedReader(_Reader(connection, self._deadline))
        return answer


def _post(address: str, named: dict[str, str], body: bytes) -> None:
    """Raise OSError or HTTPException unless the answer is 2xx."""
    opener = urllib.request.build_opener(_NoRedirects, _InTime(time.monotonic() + ANSWER_S))
    opener.open(urllib.request.Request(address, body, named), timeout=ANSWER_S).close()
