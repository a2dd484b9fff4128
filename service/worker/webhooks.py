"""Webhooks that report the end of a job, signed as in Standard Webhooks and retried until they are delivered."""

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

from service.jobs.outcomes import Delivery
from service.jobs.table import JobTable

log = logging.getLogger(__name__)

POLL_S = 1.0
ANSWER_S = 10.0  # timeout of a request


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
        "webhook-id": delivery.job_id,
        "webhook-timestamp": str(now),
        "webhook-signature": f"v1,{base64.b64encode(signed).decode()}",
    }


class _NoRedirects(urllib.request.HTTPRedirectHandler):
    """Treats 3xx as a failure: only the operator decides where webhooks go."""

    def redirect_request(self, *_request: Any) -> None:
        return None


_OPENER = urllib.request.build_opener(_NoRedirects)


def _post(address: str, named: dict[str, str], body: bytes) -> None:
    """Raise OSError or HTTPException unless the answer is 2xx."""
    _OPENER.open(urllib.request.Request(address, body, named), timeout=ANSWER_S).close()
