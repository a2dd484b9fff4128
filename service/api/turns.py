"""Limits on what runs at once: clients take turns, also at the sandbox, and few streams stay open."""

from __future__ import annotations

import asyncio
import time
from collections import Counter, deque
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any, BinaryIO

from starlette.datastructures import UploadFile

from service.api.metrics import Metrics
from service.api.problems import RETRY_AFTER, ProblemError
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
# The header of a photograph takes milliseconds and little memory. What takes more was made to.
HEADERS_AT_ONCE, MOST_WAITING_HEADERS = 3, 100
HEADER_CPU_S = 1.0
HEADER_MEMORY_BYTES = 256 << 20  # beside the file itself
WEBP_BYTES_PER_PIXEL = 8  # libwebp reserves two canvases before it tells a size; it touches neither
KNOWN_GOOD_S, KNOWN_BAD_S = 5.0, 1.0  # for which a trial is not repeated: anybody may ask for one


class Turns:
    """Places for tasks. Next is one of the client with the fewest running, of those the one served longest ago.

    places: tasks at once, of which one client never has the last; max_waiting: tasks in line, of which one client
    has half at most. For the event loop alone.
    """

    def __init__(self, places: int, max_waiting: int) -> None:
        self._places = places
        self._own_places = max(1, places - 1)
        self._max_waiting = max_waiting
        self._own_waiting = -(-max_waiting // 2)
        self._running: Counter[str] = Counter()
        self._lines: dict[str, deque[asyncio.Future[None]]] = {}  # the client served longest ago first

    @property
    def waiting(self) -> int:
        """Tasks in line."""
        return sum(map(len, self._lines.values()))

    @asynccontextmanager
    async def turn(self, client: str) -> AsyncIterator[None]:
        """One of the places, for as long as the context. Raises ProblemError 503 or 429, at once, if the line is full
        or the client's part of it.
        """
        await self._enter(client)
        try:
            yield
        finally:
            self._leave(client)

    async def _enter(self, client: str) -> None:
        place = asyncio.get_running_loop().create_future()
        self._lines.setdefault(client, deque()).append(place)
        self._admit()
        if not place.done():
            if self.waiting > self._max_waiting:
                self._forget(client, place)
                detail = "too many pictures are being processed"
                raise ProblemError(503, detail, reason="turns", headers=RETRY_SOON)
            if len(self._lines[client]) > self._own_waiting:
                self._forget(client, place)
                detail = "too many of your pictures are already waiting"
                raise ProblemError(429, detail, reason="own_turns", headers=RETRY_SOON)
        try:
            await place
        except asyncio.CancelledError:
            if place.cancelled():
                self._forget(client, place)
            else:  # it came at the same moment
                self._leave(client)
            raise

    def _forget(self, client: str, place: asyncio.Future[None]) -> None:
        line = self._lines.get(client)
        if line and place in line:  # or it was passed over already
            line.remove(place)
            if not line:
                del self._lines[client]

    def _leave(self, client: str) -> None:
        self._running[client] -= 1
        if not self._running[client]:
            del self._running[client]
        self._admit()

    def _admit(self) -> None:
        while self._running.total() < self._places:
            client = min(self._lines, key=lambda client: self._running[client], default=None)
            if client is None or self._running[client] >= self._own_places:
                return
            line = self._lines.pop(client)
            place = line.popleft()
            if line:
                self._lines[client] = line
            if not place.cancelled():  # its task may be about to leave
                place.set_result(None)
                self._running[client] += 1


class Streams:
    """Responses that stay open: streams of events, and requests that wait for a job. For the event loop alone.

    most: at once, of which one client has half at most.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._open: Counter[str] = Counter()

    @property
    def open(self) -> int:
        """How many are open."""
        return self._open.total()

    def is_full(self, client: str) -> bool:
        """Whether the client may open no more."""
        return self.open >= self._most or self._open[client] >= -(-self._most // 2)

    @contextmanager
    def one(self, client: str) -> Iterator[None]:
        """Open as long as the context. Raises ProblemError 503 if there are too many."""
        if self.is_full(client):
            detail = "too many streams of events are open"
            raise ProblemError(503, detail, reason="streams", headers=RETRY_AFTER)
        self._open[client] += 1
        try:
            yield
        finally:
            self._open[client] -= 1
            if not self._open[client]:
                del self._open[client]


class ClientTasks:
    """Tasks of the sandbox, each kind with turns of its own. client: whose turn a task takes.

    All raise TaskError, ProblemError 429 or 503, and OSError.
    """

    def __init__(self, settings: Settings, sandbox: Sandbox, metrics: Metrics) -> None:
        self._sandbox = sandbox
        self._metrics = metrics
        self._headers = Turns(HEADERS_AT_ONCE, MOST_WAITING_HEADERS)
        self._drawings = Turns(settings.max_decodes, settings.max_waiting_decodes)
        self._trying = asyncio.Lock()
        self._next_trial, self._trouble = 0.0, ""
        self._limits: dict[str, Any] = {  # of what decodes an image or a bitstream
            "memory_bytes": settings.job_memory_bytes // 4,
            "cpu_s": settings.decode_time_s,
            "max_pixels": settings.max_pixels,
        }

    async def read_header(self, client: str, image: UploadFile) -> SourceImage:
        """What an image's header says; no pixel is decoded."""
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
        """The picture file of a bitstream. limits: of the task, where it is known what will be drawn or read."""
        task = Draw(**{**self._limits, **limits}, options=options, file_kind=kind)
        began = time.perf_counter()
        made = (await self._ask(self._drawings, client, file, task)).file
        self._metrics.decode_seconds.observe(time.perf_counter() - began)  # a refusal took no time
        return made

    async def compare(self, client: str, file: BinaryIO, kind: ComparisonFormat, size: int, pixels: int) -> bytes:
        """Encode an image of so many pixels by another codec, to about `size` bytes."""
        task = Compare(**{**self._limits, "max_pixels": pixels}, file_kind=kind, size=size)
        return (await self._ask(self._drawings, client, file, task)).file

    async def preview(self, client: str, image: UploadFile, max_bytes: int) -> PreviewFigures:
        """The preview of an image."""
        task = MakePreview(**self._limits, max_bytes=max_bytes)
        made: PreviewFigures = await self._figures(self._drawings, client, image, task)
        return made

    async def _figures(self, turns: Turns, client: str, image: UploadFile, task: Task) -> Any:
        """What the sandbox finds out about an image.

        Raises ProblemError 415 for what is in none of the formats, 422 for what is damaged or beyond the limits.
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
        """Why the sandbox does no tasks; empty if it has done one within the last seconds, or now."""
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
