"""Limits on concurrent work: sandbox tasks, shared fairly between clients, and requests that wait for a job."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any, BinaryIO, Generic, TypeVar

from starlette.datastructures import UploadFile

from service.api.metrics import Metrics
from service.api.problems import ProblemError
from service.jobs.job import SourceImage
from service.pictures import ComparisonFormat, PictureFormat, PictureOptions
from service.sandbox.client import RefusedError, Sandbox, TaskError
from service.sandbox.frames import (
    FORMAT_BYTES,
    Compare,
    Draw,
    HeaderFigures,
    MakePreview,
    PreviewFigures,
    ReadHeader,
    Result,
    Task,
)
from service.settings import Settings
from sgmethod.io.formats import is_read

RETRY_SOON = {"Retry-After": "1"}
# Reading the header of a photograph takes milliseconds and little memory. A file that takes more is hostile.
HEADERS_AT_ONCE, MAX_WAITING_HEADERS = 3, 100
HEADER_CPU_S = 1.0
HEADER_MEMORY_BYTES = 256 << 20  # besides the file itself
WEBP_BYTES_PER_PIXEL = 8  # libwebp reserves two canvases to read the size, and touches neither
KNOWN_GOOD_S, KNOWN_BAD_S = 5.0, 1.0  # results of a trial are cached, since anyone may request one


T = TypeVar("T")


class Together(Generic[T]):
    """A check whose running call answers all who ask meanwhile. Use it in the event loop only."""

    def __init__(self) -> None:
        self._running: asyncio.Future[T] | None = None

    async def result(self, check: Callable[[], Awaitable[T]]) -> T:
        """Return the result of the call that runs, or of a new one."""
        if self._running is None or self._running.done():
            self._running = asyncio.ensure_future(check())
        return await asyncio.shield(self._running)


class Turns:
    """Limits concurrent tasks, shared fairly between clients. Use it in the event loop only.

    places: concurrent tasks; max_waiting: waiting tasks, of which one client may have half. A client has at most
    places - 1 tasks that run or are in line for a place, and its others wait behind these. So no client ever waits for
    many tasks of another.
    """

    def __init__(self, places: int, max_waiting: int) -> None:
        self._own_places = max(1, places - 1)
        self._max_present = places + max_waiting
        self._max_own = self._own_places + -(-max_waiting // 2)
        self._places = asyncio.Semaphore(places)
        self._clients: dict[str, asyncio.Semaphore] = {}
        self._present: Counter[str] = Counter()  # running or waiting

    @asynccontextmanager
    async def turn(self, client: str) -> AsyncIterator[None]:
        """Occupy a place for the duration of the context.

        Raises ProblemError 503 at once if the queue is full, or 429 if the client's part of it is.
        """
        if self._present.total() >= self._max_present:
            detail = "too many pictures are being processed"
            raise ProblemError(503, detail, reason="turns", headers=RETRY_SOON)
        if self._present[client] >= self._max_own:
            detail = "too many of your pictures are already waiting"
            raise ProblemError(429, detail, reason="own_turns", headers=RETRY_SOON)
        self._present[client] += 1
        try:
            async with self._clients.setdefault(client, asyncio.Semaphore(self._own_places)), self._places:
                yield
        finally:
            self._present[client] -= 1
            if not self._present[client]:
                del self._present[client], self._clients[client]


class Waits:
    """Counts requests that wait for a job. Use it in the event loop only.

    max_open: how many may wait at a time, of which one client may have half.
    """

    def __init__(self, max_open: int) -> None:
        self._max_open = max_open
        self._open: Counter[str] = Counter()

    @property
    def open(self) -> int:
        """Number of requests that wait."""
        return self._open.total()

    def is_full(self, client: str) -> bool:
        """Whether one more request of the client would be too many."""
        return self.open >= self._max_open or self._open[client] >= -(-self._max_open // 2)

    @contextmanager
    def one(self, client: str) -> Iterator[None]:
        """Count a request as waiting during the context."""
        self._open[client] += 1
        try:
            yield
        finally:
            self._open[client] -= 1
            if not self._open[client]:
                del self._open[client]


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

    async def read_header(self, client: str, image: UploadFile) -> SourceImage:
        """Read the header of an image, without decoding pixels."""
        size_bytes = image.size or 0
        pixels = self._limits["max_pixels"]
        memory_bytes = HEADER_MEMORY_BYTES + size_bytes + WEBP_BYTES_PER_PIXEL * pixels
        task = ReadHeader(memory_bytes=memory_bytes, cpu_s=HEADER_CPU_S, max_pixels=pixels, threads=1)
        header: HeaderFigures = await self._figures(self._headers, client, image, task)
        return SourceImage(header.format, header.width, header.height, size_bytes)

    async def draw(
        self,
        client: str,
        file: BinaryIO,
        options: PictureOptions,
        kind: PictureFormat,
        **limits: int,
    ) -> bytes:
        """Draw a bitstream as a picture file. limits: of the task, if the size of the output is known."""
        task = Draw(**{**self._limits, **limits}, options=options, file_kind=kind)
        began = time.perf_counter()
        made = (await self._ask(self._drawings, client, file, task)).file
        self._metrics.decode_seconds.observe(time.perf_counter() - began)  # refusals are not counted
        return made

    async def compare(self, client: str, file: BinaryIO, kind: ComparisonFormat, size: int, pixels: int) -> bytes:
        """Encode an image of so many pixels by another codec, to about `size` bytes."""
        task = Compare(**{**self._limits, "max_pixels": pixels}, file_kind=kind, size=size)
        return (await self._ask(self._drawings, client, file, task)).file

    async def preview(self, client: str, image: UploadFile, max_bytes: int) -> PreviewFigures:
        """Make a preview of an image."""
        task = MakePreview(**self._limits, max_bytes=max_bytes)
        made: PreviewFigures = await self._figures(self._drawings, client, image, task)
        return made

    async def _figures(self, turns: Turns, client: str, image: UploadFile, task: Task) -> Any:
        """Return the figures of a task on an image.

        Raises ProblemError 415 for an unknown format, 422 for an image that is damaged or beyond the limits.
        """
        try:
            return (await self._ask(turns, client, image.file, task)).figures
        except RefusedError as error:
            await image.seek(0)
            first = await image.read(FORMAT_BYTES)
            raise ProblemError(422 if is_read(first) or not first else 415, str(error)) from error
        except TaskError as error:
            raise ProblemError(422, f"the image cannot be read: {error}") from error

    async def trouble(self, patience_s: float) -> str:
        """Return why the sandbox is not working; empty if it did a task recently, or does one now."""
        async with self._trying:
            if time.monotonic() >= self._next_trial:
                try:
                    await self._sandbox.try_out(patience_s)
                    self._worked()
                except (OSError, TaskError) as error:
                    self._trouble = str(error)
                    self._next_trial = time.monotonic() + KNOWN_BAD_S
            return self._trouble

    def _worked(self) -> None:
        self._trouble, self._next_trial = "", time.monotonic() + KNOWN_GOOD_S

    async def _ask(self, turns: Turns, client: str, file: BinaryIO, task: Task) -> Result[Any]:
        async with turns.turn(client):
            result = await self._sandbox.ask(task, file)
        self._worked()
        return result
