"""Tells the operator's addresses that jobs have ended: signed as Standard Webhooks has it, tried until one answers."""

from __future__ import annotations

import base64
import hashlib
import hmac
import logging
import threading
import time
import urllib.request
from http.client import HTTPException
from typing import Any
from urllib.parse import urlsplit

from service.jobs.notices import Notice
from service.jobs.sql import JobTable
from service.jobs.table import JobTableError
from service.process.background import survived
from service.process.stopping import StopSignal
from service.worker.heartbeat import PAUSE_AFTER_TROUBLE_S

log = logging.getLogger(__name__)

POLL_S = 1.0
ANSWER_S = 10.0  # for which an answer may be silent


class Notifier(threading.Thread):
    """Delivers the notices of one address, so that one that hangs holds up no other.

    secret: the key that signs, at least 24 bytes.
    """

    def __init__(self, table: JobTable, address: str, secret: bytes, until: StopSignal) -> None:
        super().__init__(name="notifier", daemon=True)
        self._table = table
        self._address = address
        self._secret = secret
        self._until = until

    def run(self) -> None:
        pause_s = 0.0
        while not self._until.wait(pause_s):
            pause_s = PAUSE_AFTER_TROUBLE_S
            with survived("notifying"):
                try:
                    pause_s = self._send_next()
                except JobTableError as error:  # a notice that was taken is sent once more, under the same id
                    log.warning("a webhook has to wait: %s", error)

    def _send_next(self) -> float:
        """Send the next notice; returns the seconds to wait before the one after it."""
        notice = self._table.due_notice(self._address)
        if notice is None:
            return POLL_S
        if self._is_taken(notice):
            self._table.notice_delivered(notice)
        return 0.0

    def _is_taken(self, notice: Notice) -> bool:
        where = urlsplit(self._address).hostname  # the rest of an address may be a secret
        try:
            _post(self._address, headers(self._secret, notice, int(time.time())), notice.body.encode())
        except (OSError, HTTPException, ValueError) as error:  # the last for a proxy whose address is none
            log.warning("job %s: webhook to %s, try %d: %s", notice.job_id, where, notice.tries + 1, error)
            return False
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
