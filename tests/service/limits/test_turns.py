"""Fair shares among clients, on an event loop alone."""

from __future__ import annotations

import asyncio

import pytest

from service.api.callers import UNKNOWN, address_of
from service.api.problems import ProblemError
from service.api.turns import Streams, Turns


class Clients:
    """Tasks in turns; each runs until it is told to end. begun: all that have ever run."""

    def __init__(self, turns: Turns) -> None:
        self.turns = turns
        self.running: list[str] = []
        self.begun: list[str] = []
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
            self.begun.append(name)
            try:
                await self._ends[name].wait()
            finally:
                self.running.remove(name)

    async def ends(self, *names: str) -> None:
        for name in names:
            self._ends[name].set()
        await asyncio.gather(*(self._tasks[name] for name in names))
        await settle()

    async def goes(self, name: str) -> None:
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


def test_one_client_never_has_the_last_place() -> None:
    async def scenario() -> None:
        crowd = Clients(Turns(3, 100))
        await crowd.asks(*(f"eve{number}" for number in range(50)))
        assert crowd.running == ["eve0", "eve1"]
        await crowd.asks("ann1")
        assert crowd.running == ["eve0", "eve1", "ann1"]

    asyncio.run(scenario())


def test_a_single_place_serves_everybody() -> None:
    async def scenario() -> None:
        crowd = Clients(Turns(1, 100))
        await crowd.asks("eve1", "eve2", "ann1", "bob1", "ann2")
        order = []
        for _ in range(5):
            (name,) = crowd.running
            order.append(name)
            await crowd.ends(name)
        assert order == ["eve1", "eve2", "ann1", "bob1", "ann2"]
        assert crowd.turns.waiting == 0

    asyncio.run(scenario())


def test_clients_take_turns_whoever_came_first() -> None:
    async def scenario() -> None:
        crowd = Clients(Turns(2, 100))
        await crowd.asks("eve1", "ann1", "eve2", "eve3", "eve4", "bob1", "ann2")
        await crowd.ends("eve1")  # ann has one running, eve none, bob none: eve has waited longest
        assert crowd.running == ["ann1", "eve2"]
        await crowd.ends("ann1")
        assert crowd.running == ["eve2", "bob1"]
        await crowd.ends("bob1")
        assert crowd.running == ["eve2", "ann2"]
        await crowd.ends("ann2")
        assert crowd.running == ["eve2"]  # eve never has both
        await crowd.ends("eve2")
        assert crowd.running == ["eve3"]

    asyncio.run(scenario())


def test_lines_are_bounded() -> None:
    async def scenario() -> None:
        crowd = Clients(Turns(1, 4))
        await crowd.asks("eve1", "eve2", "eve3", "eve4")
        assert crowd.refusal("eve4").status == 429
        await crowd.asks("ann1", "bob1", "cat1")
        assert crowd.refusal("cat1").status == 503
        assert crowd.refusal("cat1").headers["Retry-After"]
        assert crowd.turns.waiting == 4

    asyncio.run(scenario())


def test_who_goes_leaves_nothing_behind() -> None:
    async def scenario() -> None:
        crowd = Clients(Turns(1, 10))
        await crowd.asks("eve1", "ann1", "ann2", "bob1")
        await crowd.goes("ann1")
        await crowd.goes("bob1")
        await crowd.goes("eve1")
        assert crowd.running == ["ann2"]
        await crowd.ends("ann2")
        assert crowd.turns.waiting == 0
        await crowd.asks("eve2")
        assert crowd.running == ["eve2"]

    asyncio.run(scenario())


def test_who_goes_at_the_moment_of_being_served() -> None:
    """The place was given already, and must not be lost."""

    async def scenario() -> None:
        turns = Turns(1, 10)
        crowd = Clients(turns)
        await crowd.asks("eve1", "ann1")
        crowd._ends["eve1"].set()
        while turns.waiting:  # no further than to where ann is served
            await asyncio.sleep(0)
        await crowd.goes("ann1")
        await crowd.asks("bob1")
        assert crowd.running == ["bob1"]

    asyncio.run(scenario())


@pytest.mark.parametrize("places", [1, 2, 5])
def test_as_many_at_once_as_there_are_places(places: int) -> None:
    async def scenario() -> None:
        crowd = Clients(Turns(places, 100))
        await crowd.asks(*(f"{client}{number}" for number in range(4) for client in ("ann", "bob", "cat")))
        assert len(crowd.running) == places

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


def test_streams_are_counted() -> None:
    streams = Streams(2)
    with streams.one(), streams.one():
        assert streams.full
        with pytest.raises(ProblemError) as refusal, streams.one():
            pass
        assert (refusal.value.status, refusal.value.headers["Retry-After"]) == (503, "5")
    assert (streams.open, streams.full) == (0, False)
