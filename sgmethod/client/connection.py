"""HTTP requests to one service, retried while it is busy or, once it has answered, unreachable."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import httpx2

from sgmethod.errors import ServerError

Json = dict[str, Any]
Say = Callable[[str], None]
RETRY_STATUSES = frozenset({429, 502, 503, 504})  # the server is busy, or restarting behind its proxy
PAUSE_S, MAX_PAUSE_S = 1.0, 30.0
READ_TIMEOUT_S = 60.0  # more than the longest wait
WHERE_THE_KEY_IS = "set SG_API_KEY for the command line, or api_key of a Client"
BAD_PROXY_ENVIRONMENT = (
    "an environment variable names a proxy or a file that cannot be used: HTTP_PROXY, HTTPS_PROXY, ALL_PROXY, "
    "SSL_CERT_FILE or SSLKEYLOGFILE (SOCKS needs: pip install 'httpx2[socks]')"
)
TRANSIENT_ERRORS = (httpx2.TimeoutException, httpx2.NetworkError, httpx2.RemoteProtocolError)

log = logging.getLogger("sgmethod.client")


class RefusedError(ServerError):
    """The server refused. problem: its document (RFC 9457) or {}; again_s: seconds until a retry, None for never."""

    def __init__(self, detail: str, problem: Json, again_s: float | None) -> None:
        super().__init__(detail)
        self.problem, self.again_s = problem, again_s


class Backoff:
    """Pauses between retries, growing, until a deadline: so many seconds after the first failure."""

    def __init__(self, seconds: float, say: Say) -> None:
        self._seconds, self._say = seconds, say
        self._deadline: float | None = None
        self._pause_s = PAUSE_S

    def pause(self, error: ServerError, min_s: float = 0.0) -> None:
        """Report the error and wait before the next attempt. Raises the error if the deadline would pass."""
        pause_s = max(self._pause_s, min_s)
        if self._deadline is None:
            self._deadline = time.monotonic() + self._seconds
        if time.monotonic() + pause_s > self._deadline:
            raise error
        self._say(f"{error}; trying again in {pause_s:.0f} s")
        time.sleep(pause_s)
        self._pause_s = min(2 * pause_s, MAX_PAUSE_S)


class Connection:
    """HTTP connections to one service. patience_s: time to keep trying; on_retry: called before each new attempt."""

    def __init__(self, server: str, api_key: str | None, patience_s: float, on_retry: Say) -> None:
        if api_key and not (api_key.isascii() and api_key.isprintable()):
            raise ServerError(f"the API key contains a line break or another invalid character: {WHERE_THE_KEY_IS}")
        headers = {"Authorization": f"Bearer {api_key}"} if api_key else {}
        self._server, self._patience_s, self._on_retry = server, patience_s, on_retry
        self._has_answered = False
        try:
            url = httpx2.URL(server)
            if url.scheme not in ("http", "https") or not url.host:
                raise ServerError(f"the server's address must begin with http:// or https://, got {server!r}")
            url.host.encode("idna")
        except (httpx2.InvalidURL, ValueError) as error:
            raise ServerError(f"{server!r} is not a valid address: {error}") from error
        limits = httpx2.Limits(max_connections=None)  # as many as the caller has threads
        try:
            self._http = httpx2.Client(base_url=url, headers=headers, timeout=READ_TIMEOUT_S, limits=limits)
        except (OSError, ValueError, ImportError, httpx2.InvalidURL):  # whose texts may repeat a proxy's password
            raise ServerError(BAD_PROXY_ENVIRONMENT) from None

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def ask(self, method: str, path: str, **request: Any) -> httpx2.Response:
        """Send a request and return the successful response, after retries if they may help."""
        backoff = Backoff(self._patience_s, self._on_retry)
        while True:
            try:
                answer = self._http.request(method, path, **request)
            except httpx2.RequestError as error:
                backoff.pause(self._out_of_reach(error))
                continue
            self._has_answered = True
            if answer.is_success:
                return answer
            refusal = _refusal(answer)
            if refusal.again_s is None:
                raise refusal
            backoff.pause(refusal, refusal.again_s)

    def ask_json(self, method: str, path: str, **request: Any) -> Json:
        """Send a request and return the JSON of the successful response."""
        try:
            found: Json = self.ask(method, path, **request).json()
        except ValueError as error:
            raise ServerError(f"{self._server} is not an sgmethod service: it does not answer in JSON") from error
        return found

    def _out_of_reach(self, error: httpx2.RequestError) -> ServerError:
        """Return the error to report if it may be temporary; else raise it."""
        failure = ServerError(f"{self._server} cannot be reached: {error or type(error).__name__}")
        if "CERTIFICATE_VERIFY_FAILED" in str(error):
            failure = ServerError(
                f"the certificate of {self._server} is not trusted; SSL_CERT_FILE may name one: {error}"
            )
        # If nothing has ever answered, a wrong address is more likely than a restarting server.
        never = isinstance(error, httpx2.ConnectError | httpx2.ConnectTimeout) and not self._has_answered
        if never or not isinstance(error, TRANSIENT_ERRORS):
            raise failure from error
        return failure


def _refusal(answer: httpx2.Response) -> RefusedError:
    again_s = _retry_after_s(answer.headers) if answer.status_code in RETRY_STATUSES else None
    hint = f"; {WHERE_THE_KEY_IS}" if answer.status_code == httpx2.codes.UNAUTHORIZED else ""
    with suppress(ValueError, KeyError, TypeError):
        problem = answer.json()
        return RefusedError(f"the server refused: {problem['detail']}{hint}", problem, again_s)
    return RefusedError(f"the server answered with status {answer.status_code}{hint}", {}, again_s)


def _retry_after_s(headers: Mapping[str, str]) -> float:
    text = headers.get("Retry-After", "")
    return min(float(text), MAX_PAUSE_S) if text.isdecimal() else 0.0
