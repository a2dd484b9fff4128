"""A client of the service: the same encode, on another machine.

    with Client("http://127.0.0.1:8000") as client:
        encoded = client.encode(Path("photo.jpg").read_bytes(), Budget("bpp", 0.3))

Needs httpx (pip install 'sgmethod[client]'). Whatever goes wrong is a ServerError with one clear sentence.
"""

from __future__ import annotations

import math
import secrets
import time
from contextlib import suppress
from dataclasses import dataclass
from types import TracebackType
from typing import Literal

import httpx

from sgmethod.budget import Budget
from sgmethod.client.connection import PAUSE_S, Connection, Json
from sgmethod.errors import ServerError
from sgmethod.profiles import DEFAULT_PROFILE
from sgmethod.trace import Progress, TracePoint


@dataclass(frozen=True)
class RemoteEncoded:
    """An .sg file, the server's figures of it (sgmethod.Stats as a dictionary) and the trace."""

    data: bytes
    figures: Json
    trace: list[TracePoint]


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
        budget: Budget,
        profile: str = DEFAULT_PROFILE,
        *,
        tune: str | None = None,
        time_limit_s: float | None = None,
        on_progress: Progress | None = None,
    ) -> RemoteEncoded:
        """Submit an image file, wait for the job, fetch its bitstream, and remove the job, whatever happens."""
        job_id = self.submit(image, budget, profile, tune=tune, time_limit_s=time_limit_s)
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
        tune: str | None = None,
        time_limit_s: float | None = None,
        priority: Literal["interactive", "bulk"] = "interactive",
    ) -> str:
        """The id of a new job. Tried again where that helps; the image is never accepted twice."""
        wanted = {budget.kind: budget.value, "profile": profile, "tune": tune}
        wanted |= {"priority": priority, "time_limit_s": time_limit_s}
        query = {name: value for name, value in wanted.items() if value is not None}
        headers = {"Content-Type": "image/*", "Idempotency-Key": secrets.token_hex(16)}
        return str(self._connection.ask("POST", "/encode", params=query, content=image, headers=headers).json()["id"])

    def job(self, job_id: str) -> Json:
        """State, progress, trace, result and error of a job."""
        job: Json = self._connection.ask("GET", f"/jobs/{job_id}").json()
        return job

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

    def remove(self, job_id: str) -> None:
        """Cancel the job if it is not done, and have the service forget it."""
        self._connection.ask("DELETE", f"/jobs/{job_id}")


def _point(point: Json) -> TracePoint:
    return TracePoint(**{**point, "psnr": math.inf if point["psnr"] is None else point["psnr"]})
