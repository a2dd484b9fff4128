"""Limits on concurrent work: sandbox tasks, shared fairly between clients, and requests that wait for a job."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any, BinaryIO
from weakref import WeakValueDictionary

from starlette.datastructures import UploadFile

from service.api.metrics import Metrics
from service.api.problems import ProblemError
from service.jobs.job import ImageView
from service.pictures import ComparisonFormat, PictureFormat, PictureOptions
from service.sandbox import frames
from service.sandbox.client import RefusedError, Sandbox, TaskError
from service.settings import Settings
from sgmethod.io.formats import is_read

RETRY_SOON = {"Retry-After": "1"}
# Reading the header of a photograph takes milliseconds and little memory. A file that takes more is hostile.
HEADERS_AT_ONCE, MAX_WAITING_HEADERS = 3, 100
HEADER_CPU_S = 1.0
HEADER_MEMORY_BYTES = 256 << 20  # besides the file itself
WEBP_BYTES_PER_PIXEL = 8  # libwebp reserves two canvases to read the size, and touches neither
KNOWN_GOOD_S, KNOWN_BAD_S = 5.0, 1.0  # results of a trial are cached, since anyone may request one


class Shares:
    """What clients hold of something scarce: max_total together, and max_own each. Use it in the event loop only."""

    def __init__(self, max_total: int, max_own: int) -> None:
        self._max_total = max_total
        self._max_own = max_own
        self._held: Counter[str] = Counter()

    @property
    def total(self) -> int:
        return self._held.total()

    def is_full(self) -> bool:
        return self._held.total() >= self._max_total

    def is_full_for(self, client: str) -> bool:
        return self.is_full() or self._held[client] >= self._max_own

    def refuse_if_full(self, client: str, things: str, state: str) -> None:
        """Raise ProblemError 503 if nothing is left, or 429 if the client has its part. things, state: for the text."""
        if self.is_full():
            raise ProblemError(503, f"too many {things} are {state}", reason="turns", headers=RETRY_SOON)
        if self.is_full_for(client):
            raise ProblemError(429, f"too many of your {things} are {state}", reason="own_turns", headers=RETRY_SOON)

    @contextmanager
    def hold(self, client: str, amount: int = 1) -> Iterator[None]:
        """Count an amount for the client during the context."""
        self._held[client] += amount
        try:
            yield
        finally:
            self._held[client] -= amount
            if not self._held[client]:
                del self._held[client]


class Turns:
    """Limits concurrent tasks, shared fairly between clients. Use it in the event loop only.

    places: concurrent tasks; max_waiting: waiting tasks, of which one client may have half. A client has at most
    places - 1 tasks that run or are in line for a place, and its others wait behind these. So no client ever waits for
    many tasks of another.
    """

    def __init__(self, places: int, max_waiting: int) -> None:
        self._own_places = max(1, places - 1)
        self._present = Shares(places + max_waiting, self._own_places + -(-max_waiting // 2))  # running or waiting
        self._places = asyncio.Semaphore(places)
        self._clients: WeakValueDictionary[str, asyncio.Semaphore] = WeakValueDictionary()

    @asynccontextmanager
    async def turn(self, client: str) -> AsyncIterator[None]:
        """Occupy a place for the duration of the context.

        Raises ProblemError 503 at once if the queue is full, or 429 if the client's part of it is.
        """
        self._present.refuse_if_full(client, "pictures", "being processed")
        own_places = self._clients.setdefault(client, asyncio.Semaphore(self._own_places))
        with self._present.hold(client):
            async with own_places, self._places:
                yield


class ClientTasks:
    """Runs sandbox tasks for clients, each kind with its own limit. client: whose turn a task takes.

    All methods raise TaskError, ProblemError 429 or 503, and OSError.
    """

    def __init__(self, settings: Settings, sandbox: Sandbox, metrics: Metrics) -> None:
        self._sandbox = sandbox
        self._metrics = metrics
        self._headers = Turns(HEADERS_AT_ONCE, MAX_WAITING_HEADERS)
        self._drawings = Turns(settings.max_decodes, settings.max_waiting_decodes)
        self._trying = asyncio.Lock()
        self._next_trial, self._trouble = 0.0, ""
        self._limits: dict[str, Any] = {  # of tasks that decode
            "memory_bytes": settings.decode_memory_bytes,
            "cpu_s": settings.decode_time_s,
            "max_pixels": settings.max_pixels,
        }

    async def read_header(self, client: str, image: UploadFile) -> ImageView:
        """Read the header of an image, without decoding pixels."""
        size_bytes = image.size or 0
        pixels = self._limits["max_pixels"]
        memory_bytes = HEADER_MEMORY_BYTES + size_bytes + WEBP_BYTES_PER_PIXEL * pixels
        task = frames.ReadHeader(memory_bytes=memory_bytes, cpu_s=HEADER_CPU_S, max_pixels=pixels, threads=1)
        header: frames.HeaderFigures = (await self._ask(self._headers, client, image.file, task)).figures
        return ImageView(format=header.format, width=header.width, height=header.height, bytes=size_bytes)

    async def draw(
        self, client: str, file: BinaryIO, options: PictureOptions, kind: PictureFormat, **limits: int
    ) -> bytes:
        """Draw a bitstream as a picture file. limits: of the task, if the size of the output is known."""
        task = frames.Draw(**{**self._limits, **limits}, options=options, file_kind=kind)
        began = time.perf_counter()
        drawn = (await self._ask(self._drawings, client, file, task)).file
        self._metrics.decode_seconds.observe(time.perf_counter() - began)  # refusals are not counted
        return drawn

    async def compare(self, client: str, file: BinaryIO, kind: ComparisonFormat, size: int, pixels: int) -> bytes:
        """Encode an image of so many pixels by another codec, to about `size` bytes."""
        task = frames.Compare(**{**self._limits, "max_pixels": pixels}, file_kind=kind, size=size)
        return (await self._ask(self._drawings, client, file, task)).file

    async def preview(self, client: str, image: UploadFile, max_bytes: int) -> frames.PreviewFigures:
        task = frames.MakePreview(**self._limits, max_bytes=max_bytes)
        preview: frames.PreviewFigures = (await self._ask(self._drawings, client, image.file, task)).figures
        return preview

    async def trouble(self, timeout_s: float) -> str:
        """Return why the sandbox is not working; empty if it did a task recently, or does one now."""
        async with self._trying:
            if time.monotonic() >= self._next_trial:
                try:
                    await self._sandbox.try_out(timeout_s)
                    self._worked()
                except (OSError, TaskError) as error:
                    self._trouble = str(error)
                    self._next_trial = time.monotonic() + KNOWN_BAD_S
            return self._trouble

    def _worked(self) -> None:
        self._trouble, self._next_trial = "", time.monotonic() + KNOWN_GOOD_S

    async def _ask(self, turns: Turns, client: str, file: BinaryIO, task: frames.Task) -> frames.Result[Any]:
        """Return the result of a task.

        For a task on an image in the request: raises ProblemError 415 for an unknown format, 422 for an image that is
        damaged or beyond the limits.
        """
        try:
            async with turns.turn(client):
                result = await self._sandbox.ask(task, file)
        except TaskError as error:
            if not isinstance(task, frames.ReadHeader | frames.MakePreview):
                raise
            if not isinstance(error, RefusedError):
                raise ProblemError(422, f"the image cannot be read: {error}") from error
            file.seek(0)
            first = file.read(frames.FORMAT_BYTES)
            raise ProblemError(422 if is_read(first) or not first else 415, str(error)) from error
        self._worked()
        return result
