"""A client of the service: the same encode, on another machine.

    with Client("http://127.0.0.1:8000") as client:
        encoded = client.encode("photo.jpg", Budget("bpp", 0.3))

Needs httpx2 (pip install 'sgmethod[client]'). Every failure is a ServerError with one clear sentence, except for a path
that cannot be read, which is an OSError.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal, TypedDict, Unpack
from urllib.parse import urlsplit

import httpx2

from sgmethod.arguments import AnyFloat, AnyInt
from sgmethod.budget import Budget
from sgmethod.client.connection import Connection, Json, RefusedError, Say, log
from sgmethod.encode_arguments import EncodeOptions
from sgmethod.errors import ServerError
from sgmethod.io.files import File, bytes_of
from sgmethod.profiles import DEFAULT_PROFILE, Profile, Tune
from sgmethod.trace import Progress, TracePoint

PAGE = 200  # jobs in one answer
Priority = Literal["interactive", "bulk"]
JobState = Literal["queued", "running", "done", "failed"]
WAIT_S = 50  # per request: less than the timeouts of proxies and of this client
POLL_S = 0.4  # a little more often than workers report progress


class Options(TypedDict, total=False):
    """Options of an encode, as in sgmethod.encode(). priority: "bulk" waits for jobs that are "interactive"."""

    tune: Tune | None
    effort: AnyInt
    time_limit_s: AnyFloat | None
    priority: Priority


@dataclass(frozen=True)
class RemoteEncoded:
    """An .sg file from a service; figures: sgmethod.Stats as a dictionary; notes: on what was dropped."""

    data: bytes
    figures: Json
    trace: list[TracePoint]
    notes: list[str]


class Client:
    """A client of one service.

    patience_s: time to keep trying while the service is busy or, once it has answered, unreachable; on_retry: called
    with a sentence before each new attempt; logs a warning by default.
    """

    def __init__(
        self, server: str, api_key: str | None = None, *, patience_s: float = 60.0, on_retry: Say = log.warning
    ) -> None:
        self._connection = Connection(server, api_key, patience_s, on_retry)

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._connection.close()

    def encode(
        self,
        image: File,
        budget: Budget | None = None,
        profile: Profile = DEFAULT_PROFILE,
        *,
        on_progress: Progress | None = None,
        idempotency_key: str | None = None,
        **options: Unpack[Options],
    ) -> RemoteEncoded:
        """Encode an image file (path or bytes) on the server, and remove the job afterwards in any case.

        Without on_progress, a single request fetches the bitstream if it is done soon enough. Interrupting that request
        leaves the job behind; the same request with the same idempotency_key finds it again.
        """
        query = _query(budget, profile, options)
        try:
            wait_s = WAIT_S if on_progress is None else 0
            answer = self._submit(query, bytes_of(image, ServerError), wait_s, idempotency_key)
        except RefusedError as refusal:
            if "id" not in refusal.problem:
                raise
            self._remove_if_there(refusal.problem["id"])
            raise ServerError(refusal.problem["detail"]) from None
        job_id = _id_of(answer)
        try:
            if answer.status_code == httpx2.codes.OK:
                data, job = answer.content, self.job(job_id)
            else:
                job = self.wait(job_id, on_progress)
                data = self.bitstream(job_id)
            trace = [TracePoint(**point) for point in job["trace"]]
            return RemoteEncoded(data, job["result"], trace, job["notes"])
        finally:
            self._remove_if_there(job_id)

    def submit(
        self,
        image: File,
        budget: Budget | None = None,
        profile: Profile = DEFAULT_PROFILE,
        **options: Unpack[Options],
    ) -> str:
        """Submit an image file (path or bytes) and return the id of its job. Retries never create a second job."""
        query = _query(budget, profile, options)
        return _id_of(self._submit(query, bytes_of(image, ServerError)))

    def _submit(self, query: Json, image: bytes, wait_s: int = 0, key: str | None = None) -> httpx2.Response:
        headers = {"Content-Type": "image/*", "Idempotency-Key": key or secrets.token_hex(16)}
        return self._connection.ask("POST", "/encode", params={**query, "wait": wait_s}, content=image, headers=headers)

    def job(self, job_id: str) -> Json:
        """Return a job's state, progress, trace, result and error."""
        return self._connection.ask_json("GET", f"/jobs/{job_id}")

    def jobs(self, state: JobState | None = None) -> Iterator[Json]:
        """Yield all jobs visible to this client, newest first, without traces; optionally only those in one state."""
        path: str | None = f"/jobs?limit={PAGE}" + ("" if state is None else f"&state={state}")
        while path is not None:
            page: Json = self._connection.ask_json("GET", path)
            yield from page["jobs"]
            # Only the query is used: the path may have a proxy's prefix, which the client's address has already.
            path = page["next"] and f"/jobs?{urlsplit(page['next']).query}"

    def wait(self, job_id: str, on_progress: Progress | None = None) -> Json:
        """Wait for a job and return it with its trace. Raises ServerError if it fails or is removed."""
        attempt = reported = 0
        while True:
            job = self.job(job_id)
            if job["attempt"] != attempt:  # which starts a new trace
                attempt, reported = job["attempt"], 0
            if on_progress is not None:
                for point in job["trace"][reported:]:
                    on_progress(TracePoint(**point))
                reported = len(job["trace"])
            if job["state"] == "done":
                return job
            if job["state"] == "failed":
                raise ServerError(job["error"]["detail"])
            time.sleep(POLL_S)

    def bitstream(self, job_id: str) -> bytes:
        """Fetch the .sg file of a finished job."""
        return self._connection.ask("GET", f"/bitstreams/{job_id}.sg").content

    def picture(self, job_id: str, kind: str = "png", **view: float | str) -> bytes:
        """Fetch the picture of a finished job, as "png" or another format of GET /decode.

        view: parameters of the request, such as width=320, height=240, fit="crop" or region="x,y,w,h".
        """
        return self._connection.ask("GET", f"/decode/{job_id}.{kind}", params=view).content

    def decode(self, bitstream: File, kind: str = "png", **view: float | str) -> bytes:
        """Decode an .sg file (path or bytes) on the server, which does not store it; otherwise like `picture`."""
        data = bytes_of(bitstream, ServerError)
        return self._connection.ask("POST", f"/decode.{kind}", params=view, content=data).content

    def links(self, job_id: str, expires_s: int = 3600) -> Json:
        """Create URLs of a job's picture and bitstream that need no API key for expires_s seconds."""
        return self._connection.ask_json("POST", f"/jobs/{job_id}/links", params={"expires_s": expires_s})

    def remove(self, job_id: str) -> None:
        """Cancel the job if it is not done, and delete everything stored for it."""
        self._connection.ask("DELETE", f"/jobs/{job_id}")

    def _remove_if_there(self, job_id: str) -> None:
        with suppress(ServerError):
            self.remove(job_id)


def _query(budget: Budget | None, profile: Profile, options: Options) -> Json:
    wanted: Json = {**EncodeOptions(profile=profile).options(), "priority": "interactive", **options}
    if budget is not None:
        wanted[budget.kind] = budget.value
    return {name: value for name, value in wanted.items() if value is not None}


def _id_of(answer: httpx2.Response) -> str:
    """Return the id of the job that a request has created. Raises ServerError if there is none."""
    if "Location" not in answer.headers:
        raise ServerError(f"{answer.url.copy_with(path='/', query=None)} is not an sgmethod service: it created no job")
    return str(answer.headers["Location"].rpartition("/")[2])
