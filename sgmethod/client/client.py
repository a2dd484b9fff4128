"""A client of the service: the same encode, on another machine.

    with Client("http://127.0.0.1:8000") as client:
        encoded = client.encode(Path("photo.jpg").read_bytes(), Budget("bpp", 0.3))

Needs httpx (pip install 'sgmethod[client]'). Whatever goes wrong is a ServerError with one clear sentence.
"""

from __future__ import annotations

import math
import secrets
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from types import TracebackType
from typing import Literal

import httpx

from sgmethod.budget import DEFAULT_BUDGET, Budget
from sgmethod.client.connection import PAUSE_S, Connection, Json, RefusedError
from sgmethod.errors import ServerError
from sgmethod.profiles import DEFAULT_EFFORT, DEFAULT_PROFILE
from sgmethod.trace import Progress, TracePoint

Priority = Literal["interactive", "bulk"]
JobState = Literal["queued", "running", "done", "failed"]
WAIT_S = 50  # of one request: less than what proxies, and this client, take for a connection that has died


@dataclass(frozen=True)
class RemoteEncoded:
    """An .sg file, the server's figures of it (sgmethod.Stats as a dictionary), the trace, and notes: what of the image
    is left out."""

    data: bytes
    figures: Json
    trace: list[TracePoint]
    notes: list[str]


class Client:
    """One service. patience_s: how long to go on trying while it is busy or out of reach, in seconds."""

    def __init__(self, server: str, api_key: str | None = None, *, patience_s: float = 60.0) -> None:
        self._connection = Connection(server, api_key, patience_s)

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of connections."""
        self._connection.close()

    def encode(
        self,
        image: bytes,
        budget: Budget = DEFAULT_BUDGET,
        profile: str = DEFAULT_PROFILE,
        *,
        tune: str | None = None,
        effort: int = DEFAULT_EFFORT,
        time_limit_s: float | None = None,
        priority: Priority = "interactive",
        on_progress: Progress | None = None,
    ) -> RemoteEncoded:
        """The bitstream of an image file, with its figures and its trace; its job is removed, whatever happens.

        Without on_progress one request brings the bitstream, if the server has it soon enough. Whoever interrupts that
        request leaves the job behind.
        """
        query = _query(budget, profile, tune, effort, time_limit_s, priority)
        try:
            answer = self._submit("/encode", query, image, wait_s=WAIT_S if on_progress is None else 0)
        except RefusedError as refusal:
            if "id" not in refusal.problem:
                raise
            self._remove_if_there(refusal.problem["id"])
            raise ServerError(refusal.problem["detail"]) from None
        job_id = answer.headers["Location"].rpartition("/")[2]
        try:
            if answer.status_code == httpx.codes.OK:
                data, job = answer.content, self.job(job_id)
            else:
                job = self.wait(job_id, on_progress)
                data = self.bitstream(job_id)
            trace = [_point(point) for point in job["trace"]]
            return RemoteEncoded(data, job["result"], trace, job.get("notes", []))  # older servers have none
        finally:
            self._remove_if_there(job_id)

    def submit(
        self,
        image: bytes,
        budget: Budget = DEFAULT_BUDGET,
        profile: str = DEFAULT_PROFILE,
        *,
        tune: str | None = None,
        effort: int = DEFAULT_EFFORT,
        time_limit_s: float | None = None,
        priority: Priority = "interactive",
    ) -> str:
        """The id of a new job. Tried again where that helps; the image is never accepted twice."""
        query = _query(budget, profile, tune, effort, time_limit_s, priority)
        return str(self._submit("/encode", query, image).json()["id"])

    def submit_again(
        self,
        job_id: str,
        budget: Budget,
        profile: str = DEFAULT_PROFILE,
        *,
        tune: str | None = None,
        effort: int = DEFAULT_EFFORT,
        time_limit_s: float | None = None,
        priority: Priority = "interactive",
    ) -> str:
        """The id of a new job with the image of another, which is not sent a second time. Raises ServerError once the
        server keeps it no longer.
        """
        query = _query(budget, profile, tune, effort, time_limit_s, priority)
        return str(self._submit(f"/jobs/{job_id}/encode", query).json()["id"])

    def _submit(self, path: str, query: Json, image: bytes = b"", wait_s: int = 0) -> httpx.Response:
        headers = {"Content-Type": "image/*", "Idempotency-Key": secrets.token_hex(16)}
        if wait_s:
            headers["Prefer"] = f"wait={wait_s}"  # which a server that does not know it ignores
        return self._connection.ask("POST", path, params=query, content=image, headers=headers)

    def job(self, job_id: str) -> Json:
        """State, progress, trace, result and error of a job."""
        job: Json = self._connection.ask("GET", f"/jobs/{job_id}").json()
        return job

    def jobs(self, state: JobState | None = None) -> Iterator[Json]:
        """All jobs that this client may see, or those in one state, newest first, without their traces."""
        path: str | None = "/jobs?limit=200" + ("" if state is None else f"&state={state}")
        while path is not None:
            page: Json = self._connection.ask("GET", path).json()
            yield from page["jobs"]
            path = page["next"]

    def wait(self, job_id: str, on_progress: Progress | None = None) -> Json:
        """The job once it is done, with its trace. Raises ServerError if it fails or is removed."""
        deadline = time.monotonic() + self._connection.patience_s
        while True:
            try:
                for name, data in self._connection.events(job_id):
                    deadline = time.monotonic() + self._connection.patience_s
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
                    raise self._connection.out_of_reach(error) from error
            time.sleep(PAUSE_S)  # the stream broke, or the service restarts

    def bitstream(self, job_id: str) -> bytes:
        """The .sg file of a job that is done."""
        return self._connection.ask("GET", f"/bitstreams/{job_id}.sg").content

    def picture(self, job_id: str, kind: str = "png", **view: float | str) -> bytes:
        """The picture of a job that is done, as "png", "jpg", "webp" or "avif".

        view: as in the service's requests, such as width=320, height=240, fit="crop" or region="x,y,w,h".
        """
        return self._connection.ask("GET", f"/decode/{job_id}.{kind}", params=view).content

    def stop(self, job_id: str) -> None:
        """End the fit of a running job early: it is done soon, with what is there. Raises ServerError if it waits."""
        self._connection.ask("POST", f"/jobs/{job_id}/stop")

    def decode(self, bitstream: bytes, kind: str = "png", **view: float | str) -> bytes:
        """A picture of an .sg file, which the server does not keep; otherwise as `picture`."""
        return self._connection.ask("POST", f"/decode.{kind}", params=view, content=bitstream).content

    def links(self, job_id: str, expires_s: int = 3600) -> Json:
        """URLs of picture and bitstream, on this server, that need no key for so many seconds."""
        links: Json = self._connection.ask("POST", f"/jobs/{job_id}/links", params={"expires_s": expires_s}).json()
        return links

    def remove(self, job_id: str) -> None:
        """Cancel the job if it is not done, and have the service forget it."""
        self._connection.ask("DELETE", f"/jobs/{job_id}")

    def _remove_if_there(self, job_id: str) -> None:
        with suppress(ServerError):
            self.remove(job_id)


def _query(
    budget: Budget, profile: str, tune: str | None, effort: int, time_limit_s: float | None, priority: Priority
) -> Json:
    """The fields of an encode."""
    wanted = {budget.kind: budget.value, "profile": profile, "tune": tune}
    wanted |= {"priority": priority, "time_limit_s": time_limit_s}
    wanted |= {"effort": None if effort == DEFAULT_EFFORT else effort}  # which older servers do not know
    return {name: value for name, value in wanted.items() if value is not None}


def _point(point: Json) -> TracePoint:
    return TracePoint(**{**point, "psnr": math.inf if point["psnr"] is None else point["psnr"]})
