"""Limits on what runs at once: clients take turns, and few streams stay open."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager

from service.api.problems import ProblemError

RETRY_AFTER = {"Retry-After": "1"}


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
                raise ProblemError(503, detail, reason="turns", headers=RETRY_AFTER)
            if len(self._lines[client]) > self._own_waiting:
                self._forget(client, place)
                detail = "too many of your pictures are already waiting"
                raise ProblemError(429, detail, reason="own_turns", headers=RETRY_AFTER)
        try:
            await place
        except asyncio.CancelledError:
            if place.cancelled():
                self._forget(client, place)
            else:  # it came at the same moment
                self._leave(client)
            raise

    def _forget(self, client: str, place: asyncio.Future[None]) -> None:
        line = self._lines[client]
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
            line.popleft().set_result(None)
            self._running[client] += 1
            if line:
                self._lines[client] = line


class Streams:
    """Responses that stay open: streams of events, and requests that wait for a job. For the event loop alone."""

    def __init__(self, most: int) -> None:
        self._most = most
        self.open = 0

    @property
    def full(self) -> bool:
        """Whether no more may be opened."""
        return self.open >= self._most

    @contextmanager
    def one(self) -> Iterator[None]:
        """Open as long as the context. Raises ProblemError 503 if there are too many."""
        if self.full:
            raise ProblemError(
                503, "too many streams of events are open", reason="streams", headers={"Retry-After": "5"}
            )
        self.open += 1
        try:
            yield
        finally:
            self.open -= 1
