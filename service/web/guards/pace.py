"""Of one client, few requests begin at once, so that those of others come in between."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from service.web.guards.problems import ProblemError, refused
from service.web.guards.shares import RETRY_AFTER, client_of

# A request takes the loop about 2 ms, and has to wait for every other that has begun. A client without company gains
# nothing from more.
BEGUN_AT_ONCE = 16
MOMENT_S = 0.1


class Pace:
    """Turns in which requests begin. The next one of a client begins when one of its has been answered, or after
    moment_s: what takes longer than that waits for something else than the loop.

    most_waiting: of one client. For the event loop alone.
    """

    def __init__(self, at_once: int, moment_s: float, most_waiting: int) -> None:
        self._at_once = at_once
        self._moment_s = moment_s
        self._most_waiting = most_waiting
        self._begun: Counter[str] = Counter()
        self._lines: dict[str, deque[asyncio.Future[None]]] = {}

    @asynccontextmanager
    async def turn(self, client: str) -> AsyncIterator[None]:
        """The context begins when it is the client's turn. Raises ProblemError 429, at once, if its line is full."""
        await self._enter(client)
        held = True

        def leave() -> None:
            nonlocal held
            if held:
                held = False
                self._leave(client)

        timer = asyncio.get_running_loop().call_later(self._moment_s, leave)
        try:
            yield
        finally:
            timer.cancel()
            leave()

    async def _enter(self, client: str) -> None:
        if self._begun[client] < self._at_once:
            self._begun[client] += 1
            return
        line = self._lines.setdefault(client, deque())
        if len(line) >= self._most_waiting:
            detail = "too many of your requests are already waiting"
            raise ProblemError(429, detail, reason="own_requests", headers=RETRY_AFTER)
        place = asyncio.get_running_loop().create_future()
        line.append(place)
        try:
            await place
        except asyncio.CancelledError:
            if not place.cancelled():  # its turn came at the same moment
                self._leave(client)
            raise

    def _leave(self, client: str) -> None:
        line = self._lines.get(client, deque())
        while line:
            place = line.popleft()
            if not place.done():
                place.set_result(None)
                return
        self._lines.pop(client, None)
        self._begun[client] -= 1
        if not self._begun[client]:
            del self._begun[client]


class PacedRequests:
    """Middleware: requests begin at the pace of their clients, or get 429."""

    def __init__(self, app: ASGIApp, most_waiting: int) -> None:
        self._app = app
        self._pace = Pace(BEGUN_AT_ONCE, MOMENT_S, most_waiting)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            async with self._pace.turn(client_of(scope)):
                await self._app(scope, receive, send)
        except ProblemError as problem:  # of the line: the application answers with its own
            await refused(Request(scope), problem)(scope, receive, send)
