"""Fair shares among clients, on an event loop alone."""

from __future__ import annotations

import asyncio

import pytest

from service.api.gate import UNKNOWN, address_of
from service.api.problems import ProblemError
from service.api.turns import Shares, Turns


class Clients:
    """Tasks in turns; each runs until it is released."""

    def __init__(self, turns: Turns) -> None:
        self.turns = turns
        self.running: list[str] = []
        self._ends: dict[str, asyncio.Event] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}

    async def asks(self, *names: str) -> None:
        """Each name is a client and a number, such as ann1."""
        for name in names:
            self._ends[name] = asyncio.Event()
            self._tasks[name] = asyncio.create_task(self._run(name))
            await settle()

    async def _run(self, name: str) -> None:
        async with self.turns.turn(name[:3]):
            self.running.append(name)
            try:
                await self._ends[name].wait()
            finally:
                self.running.remove(name)

    async def ends(self, *names: str) -> None:
        for name in names:
            self._ends[name].set()
        await asyncio.gather(*(self._tasks[name] for name in names))
        await settle()

    async def leaves(self, name: str) -> None:
        """The client does not wait any longer."""
        self._tasks[name].cancel()
        await asyncio.gather(self._tasks[name], return_exceptions=True)
        await settle()

    def refusal(self, name: str) -> ProblemError:
        error = self._tasks[name].exception()
        assert isinstance(error, ProblemError)
        return error


async def settle() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


# How many places there are; then who asks, ends or leaves, and who is served after that.
SCENARIOS: dict[str, tuple[int, list[tuple[str, str, str]]]] = {
    "one client never has the last place": (
        3,
        [("asks", "eve0 eve1 eve2 eve3 eve4", "eve0 eve1"), ("asks", "ann1", "eve0 eve1 ann1")],
    ),
    "a single place serves everybody": (
        1,
        [
            *(("asks", "eve1 eve2 ann1 bob1 ann2", "eve1"), ("ends", "eve1", "ann1"), ("ends", "ann1", "bob1")),
            *(("ends", "bob1", "eve2"), ("ends", "eve2", "ann2"), ("ends", "ann2", "")),
        ],
    ),
    "who leaves leaves nothing behind": (
        1,
        [
            *(("asks", "eve1 ann1 ann2 bob1", "eve1"), ("leaves", "ann1", "eve1"), ("leaves", "bob1", "eve1")),
            *(("leaves", "eve1", "ann2"), ("ends", "ann2", ""), ("asks", "eve2", "eve2")),
        ],
    ),
    "five places": (5, [("asks", "ann0 bob0 cat0 ann1 bob1 cat1", "ann0 bob0 cat0 ann1 bob1")]),
}


@pytest.mark.parametrize("name", SCENARIOS)
def test_whose_turn_it_is(name: str) -> None:
    places, steps = SCENARIOS[name]

    async def scenario() -> None:
        crowd = Clients(Turns(places, 100))
        for step, names, served in steps:
            await {"asks": crowd.asks, "ends": crowd.ends, "leaves": crowd.leaves}[step](*names.split())
            assert crowd.running == served.split()

    asyncio.run(scenario())


def test_lines_are_bounded() -> None:
    async def scenario() -> None:
        crowd = Clients(Turns(1, 4))
        await crowd.asks("eve1", "eve2", "eve3", "eve4")
        assert crowd.refusal("eve4").status == 429
        await crowd.asks("ann1", "bob1", "cat1")
        assert crowd.refusal("cat1").status == 503
        assert crowd.refusal("cat1").headers["Retry-After"]

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("peer", "client"),
    [
        (("192.0.2.1", 80), "192.0.2.1"),
        (("::ffff:192.0.2.1", 80), "192.0.2.1"),
        (("2001:db8:1:2:3:4:5:6", 80), "2001:db8:1:2::"),
        (("2001:db8:1:2::9", 80), "2001:db8:1:2::"),
        (("socket", 0), UNKNOWN),
        (None, UNKNOWN),
    ],
)
def test_a_client_is_an_address_or_a_customers_network(peer: tuple[str, int] | None, client: str) -> None:
    assert address_of(peer) == client


def test_places_to_wait_are_shared() -> None:
    """One client leaves half of them to others."""
    waits = Shares(4, 2)
    with waits.hold("ann"), waits.hold("ann"):
        assert waits.is_full_for("ann")
        assert not waits.is_full()
        with waits.hold("bob"), waits.hold("bob"):
            assert waits.is_full_for("cat")
            assert waits.total == 4
    assert waits.total == 0
    assert not waits.is_full_for("ann")
