"""Fair shares: clients take turns, however much one of them asks for."""

from __future__ import annotations

import asyncio
import math
import sys
from collections import Counter, deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from service.web.guards.problems import ProblemError

RETRY_AFTER = {"Retry-After": "1"}


class Turns:
    """Places for errands. Next is one of the client with the fewest running, of those the one served longest ago.

    places: errands at once, of which one client never has the last; max_waiting: errands in line, of which one client
    has half at most. For the event loop alone.
    """

    what, reason = "pictures", "turns"  # errands in words, and the word for a refusal in figures and logs
    moment_s = math.inf  # after which another may have the place, though the errand goes on

    def __init__(self, places: int, max_waiting: int) -> None:
        self._places = places
        self._own_places = max(1, places - 1)
        self._max_waiting = max_waiting
        self._own_waiting = -(-max_waiting // 2)
        self._running: Counter[str] = Counter()
        self._lines: dict[str, deque[asyncio.Future[None]]] = {}  # the client served longest ago first

    @property
    def waiting(self) -> int:
        """Errands in line."""
        return sum(map(len, self._lines.values()))

    @asynccontextmanager
    async def turn(self, client: str) -> AsyncIterator[None]:
        """One of the places, for as long as the context. Raises ProblemError 503 or 429, at once, if the line is full
        or the client's part of it.
        """
        await self._enter(client)
        held = [client]

        def leave() -> None:
            if held:
                self._leave(held.pop())

        timer = asyncio.get_running_loop().call_later(self.moment_s, leave) if self.moment_s < math.inf else None
        try:
            yield
        finally:
            if timer is not None:
                timer.cancel()
            leave()

    async def _enter(self, client: str) -> None:
        place = asyncio.get_running_loop().create_future()
        self._lines.setdefault(client, deque()).append(place)
        self._admit()
        if not place.done():
            if self.waiting > self._max_waiting:
                self._forget(client, place)
                detail = f"too many {self.what} are being processed"
                raise ProblemError(503, detail, reason=self.reason, headers=RETRY_AFTER)
            if len(self._lines[client]) > self._own_waiting:
                self._forget(client, place)
                detail = f"too many of your {self.what} are already waiting"
                raise ProblemError(429, detail, reason=f"own_{self.reason}", headers=RETRY_AFTER)
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


class Pace(Turns):
    """Turns in which requests begin. The next one of a client begins when one of its has been answered, or after a
    moment: what takes longer than that waits for something else than the loop. Clients do not wait for each other.

    at_once: of one client; most_waiting: of one client.
    """

    what, reason = "requests", "requests"

    def __init__(self, at_once: int, moment_s: float, most_waiting: int) -> None:
        super().__init__(places=sys.maxsize, max_waiting=sys.maxsize)
        self._own_places, self._own_waiting, self.moment_s = at_once, most_waiting, moment_s
