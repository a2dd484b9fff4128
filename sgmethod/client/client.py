"""A client of the service: the same encode, on another machine.

    with Client("http://127.0.0.1:8000") as client:
        encoded = client.encode(Path("photo.jpg").read_bytes(), Budget("bpp", 0.3))

Needs httpx (pip install 'sgmethod[client]'). Whatever goes wrong is a ServerError with one clear sentence.
"""

from __future__ import annotations

import json
import math
import secrets
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Literal

import httpx

from sgmethod.budget import Budget
from sgmethod.errors import ServerError
from sgmethod.profiles import DEFAULT_PROFILE
from sgmethod.trace import Progress, TracePoint

Json = dict[str, Any]
AGAIN = frozenset({429, 503})  # the server is busy, and says when to come back
PAUSE_S, LONGEST_PAUSE_S = 1.0, 30.0
SILENCE_S = 60.0  # the server sends a sign of life every 15 s


@dataclass(frozen=True)
class RemoteEncoded:
    """An .sg file, the server's figures of it (sgmethod.Stats as a dictionary) and the trace."""

    data: bytes
    figures: Json
    trace: list[TracePoint]


class Client:
    """One service. patience_s: how long to go on trying while it is busy or out of reach, in seconds."""

    def __init__(self, server: str, api_key: str | None = None, *, patience_s: float = 60.0) -> None:
        headers = {"Authorization": f"Bearer {api_key}"} if api_key else {}
        self._server = server
        self._patience_s = patience_s
        try:
            self._http = httpx.Client(base_url=server, headers=headers, timeout=SILENCE_S)
        except (httpx.InvalidURL, UnicodeError) as error:
            raise ServerError(f"{server!r} or its API key cannot be used: {error}") from error

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of connections."""
        self._http.close()

    def encode(
        self,
        image: bytes,
        budget: Budget,
        profile: str = DEFAULT_PROFILE,
        *,
        time_limit_s: float | None = None,
        on_progress: Progress | None = None,
    ) -> RemoteEncoded:
        """Submit an image file, wait for the job, fetch its bitstream, and remove the job, whatever happens."""
        job_id = self.submit(image, budget, profile, time_limit_s=time_limit_s)
        try:
            job = self.wait(job_id, on_progress)
            return RemoteEncoded(self.bitstream(job_id), job["result"], [_point(point) for point in job["trace"]])
        finally:
            with suppress(ServerError):
                self.remove(job_id)

    def submit(
        self,
        image: bytes,
        budget: Budget,
        profile: str = DEFAULT_PROFILE,
        *,
        time_limit_s: float | None = None,
        priority: Literal["interactive", "bulk"] = "interactive",
    ) -> str:
        """The id of a new job. Tried again where that helps; the image is never accepted twice."""
        wanted = {budget.kind: budget.value, "profile": profile, "priority": priority, "time_limit_s": time_limit_s}
        query = {name: value for name, value in wanted.items() if value is not None}
        headers = {"Content-Type": "image/*", "Idempotency-Key": secrets.token_hex(16)}
        return str(self._ask("POST", "/encode", params=query, content=image, headers=headers).json()["id"])

    def job(self, job_id: str) -> Json:
        """State, progress, trace, result and error of a job."""
        job: Json = self._ask("GET", f"/jobs/{job_id}").json()
        return job

    def wait(self, job_id: str, on_progress: Progress | None = None) -> Json:
        """The job once it is done, with its trace. Raises ServerError if it fails or is removed."""
        deadline = time.monotonic() + self._patience_s
        while True:
            try:
                for name, data in self._events(job_id):
                    deadline = time.monotonic() + self._patience_s
                    if name == "trace" and on_progress is not None:
                        for point in data["trace"]:
                            on_progress(_point(point))
                    if name == "done":
                        return self.job(job_id)
                    if name == "failed":
                        raise ServerError(data["error"]["detail"])
                    if name == "removed":
                        raise ServerError("the job was removed before it was done")
            except httpx.TransportError as error:
                if time.monotonic() > deadline:
                    raise self._out_of_reach(error) from error
            time.sleep(PAUSE_S)  # the stream broke, or the service restarts

    def bitstream(self, job_id: str) -> bytes:
        """The .sg file of a job that is done."""
        return self._ask("GET", f"/bitstreams/{job_id}.sg").content

    def picture(self, job_id: str, kind: str = "png", **view: float | str) -> bytes:
        """The picture of a job that is done, as "png", "jpg" or "webp"; view: scale, width, region="x,y,w,h"."""
        return self._ask("GET", f"/decode/{job_id}.{kind}", params=view).content

    def remove(self, job_id: str) -> None:
        """Cancel the job if it is not done, and have the service forget it."""
        self._ask("DELETE", f"/jobs/{job_id}")

    def _ask(self, method: str, path: str, **request: Any) -> httpx.Response:
        """The answer, if it is one of success; tried again while the server is busy or out of reach."""
        deadline = time.monotonic() + self._patience_s
        pause_s = PAUSE_S
        while True:
            try:
                answer = self._http.request(method, path, **request)
            except httpx.TransportError as error:
                if time.monotonic() + pause_s > deadline:
                    raise self._out_of_reach(error) from error
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

    def _events(self, job_id: str) -> Iterator[tuple[str, Json]]:
        """Names and data of the job's events until the stream ends."""
        with self._http.stream("GET", f"/jobs/{job_id}/events") as answer:
            if answer.status_code in AGAIN:
                return
            if not answer.is_success:
                answer.read()
                raise _refusal(answer)
            name = ""
            for line in answer.iter_lines():
                field, _, value = line.partition(": ")
                if field == "event":
                    name = value
                elif field == "data":
                    yield name, json.loads(value)

    def _out_of_reach(self, error: httpx.TransportError) -> ServerError:
        return ServerError(f"{self._server} cannot be reached: {error or type(error).__name__}")


def _refusal(answer: httpx.Response) -> ServerError:
    with suppress(ValueError, KeyError, TypeError):
        return ServerError(f"the server refused: {answer.json()['detail']}")
    return ServerError(f"the server answered with status {answer.status_code}")


def _retry_after_s(headers: Mapping[str, str]) -> float:
    text = headers.get("Retry-After", "")
    return min(float(text), LONGEST_PAUSE_S) if text.isdecimal() else 0.0


def _point(point: Json) -> TracePoint:
    return TracePoint(**{**point, "psnr": math.inf if point["psnr"] is None else point["psnr"]})
