"""Tells the operator's addresses that jobs have ended: signed as Standard Webhooks has it, tried until one answers."""

from __future__ import annotations

import base64
import hashlib
import hmac
import logging
import time
import urllib.request
from http.client import HTTPException
from typing import Any
from urllib.parse import urlsplit

from service.jobs.endings import Notice
from service.jobs.table import JobTable

log = logging.getLogger(__name__)

POLL_S = 1.0
ANSWER_S = 10.0  # how long an address may be silent


def send_next(table: JobTable, address: str, secret: bytes) -> bool:
    """Send the next notice of the address; False if none is due. secret: the key that signs, at least 24 bytes.

    Each address has rounds of its own, so that one that hangs holds up no other. Raises JobTableError.
    """
    notice = table.due_notice(address)
    if notice is None:
        return False
    where = urlsplit(address).hostname  # the rest of an address may be a secret
    try:
        _post(address, headers(secret, notice, int(time.time())), notice.body.encode())
    except (OSError, HTTPException, ValueError) as error:  # ValueError: a proxy with an address that cannot be one
        log.warning("job %s: webhook to %s: %s", notice.job_id, where, error)
        return True
    table.notice_delivered(notice)  # if that fails it is sent once more, under the same id
    log.info("job %s: webhook to %s delivered", notice.job_id, where)
    return True


def headers(secret: bytes, notice: Notice, now: int) -> dict[str, str]:
    """The id, which each try has again, the time in seconds since 1970, and the signature of both and the body."""
    signed = hmac.new(secret, f"{notice.job_id}.{now}.{notice.body}".encode(), hashlib.sha256).digest()
    return {
        "Content-Type": "application/json",
        "webhook-id": notice.job_id,
        "webhook-timestamp": str(now),
        "webhook-signature": f"v1,{base64.b64encode(signed).decode()}",
    }


class _NoRedirects(urllib.request.HTTPRedirectHandler):
    """The operator names where notices go, and nobody else: 3xx is a failure."""

    def redirect_request(self, *_request: Any) -> None:
        return None


_OPENER = urllib.request.build_opener(_NoRedirects)


def _post(address: str, named: dict[str, str], body: bytes) -> None:
    """Raises OSError, HTTPException: also for an answer other than 2xx."""
    _OPENER.open(urllib.request.Request(address, body, named), timeout=ANSWER_S).close()
