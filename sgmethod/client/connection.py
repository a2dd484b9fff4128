"""One service over HTTP: asked again while it is busy or out of reach."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any

import httpx
from httpx_sse import EventSource

from sgmethod.errors import ServerError

Json = dict[str, Any]
AGAIN = frozenset({429, 503})  # the server is busy, and says when to come back
PAUSE_S, LONGEST_PAUSE_S = 1.0, 30.0
SILENCE_S = 60.0  # the server sends a sign of life every 15 s


class RefusedError(ServerError):
    """The server refused. problem: its document (RFC 9457), empty if it sent none."""

    def __init__(self, detail: str, problem: Json) -> None:
        super().__init__(detail)
        self.problem = problem


class Connection:
    """patience_s: how long to go on trying, in seconds."""

    def __init__(self, server: str, api_key: str | None, patience_s: float) -> None:
        headers = {"Authorization": f"Bearer {api_key}"} if api_key else {}
        self._server = server
        self.patience_s = patience_s
        try:
            self._http = httpx.Client(base_url=server, headers=headers, timeout=SILENCE_S)
        except (httpx.InvalidURL, UnicodeError) as error:
            raise ServerError(f"{server!r} or its API key cannot be used: {error}") from error

    def close(self) -> None:
        """Let go of connections."""
        self._http.close()

    def ask(self, method: str, path: str, **request: Any) -> httpx.Response:
        """The answer, if it is one of success; tried again while the server is busy or out of reach."""
        deadline = time.monotonic() + self.patience_s
        pause_s = PAUSE_S
        while True:
            try:
                answer = self._http.request(method, path, **request)
            except httpx.TransportError as error:
                if time.monotonic() + pause_s > deadline:
                    raise self.out_of_reach(error) from error
            else:
                if answer.is_success:
                    return answer
                if answer.status_code not in AGAIN:
                    raise _refusal(answer)
                pause_s = max(pause_s, _retry_after_s(answer.headers))
                if time.monotonic() + pause_s > deadline:
                    raise _refusal(answer)
            time.sleep(pause_s)
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)

    def events(self, job_id: str) -> Iterator[tuple[str, Json]]:
        """Names and data of the job's events until the stream ends."""
        with self._http.stream("GET", f"/jobs/{job_id}/events") as answer:
            if answer.status_code in AGAIN:
                return
            if not answer.is_success:
                answer.read()
                raise _refusal(answer)
            for event in EventSource(answer).iter_sse():
                yield event.event, event.json()

    def out_of_reach(self, error: httpx.TransportError) -> ServerError:
        """What to say when trying again has not helped."""
        return ServerError(f"{self._server} cannot be reached: {error or type(error).__name__}")


def _refusal(answer: httpx.Response) -> RefusedError:
    with suppress(ValueError, KeyError, TypeError):
        problem = answer.json()
        return RefusedError(f"the server refused: {problem['detail']}", problem)
    return RefusedError(f"the server answered with status {answer.status_code}", {})


def _retry_after_s(headers: Mapping[str, str]) -> float:
    text = headers.get("Retry-After", "")
    return min(float(text), LONGEST_PAUSE_S) if text.isdecimal() else 0.0
