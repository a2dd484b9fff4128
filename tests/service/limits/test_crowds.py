"""Very many connections and requests of one client at once: others come in between."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from service.web.guards.crowd import Crowd
from service.web.guards.turns import Pace
from tests.harness.data import ROOT
from tests.harness.service import Service, StartService
from tests.service.limits.test_turns import Clients, settle

pytestmark = pytest.mark.thorough

PICTURE = (ROOT / "service/web/static/samples/cat.sg").read_bytes()
LIVE = b"GET /livez HTTP/1.1\r\nHost: test\r\n\r\n"
NEVER_S = 10_000
OTHER = "127.0.0.2"  # an address beside the one that a crowd comes from


def test_a_crowd_knows_who_has_been_quiet_for_longest() -> None:
    crowd: Crowd[str] = Crowd()
    for member in ("eve1", "ann1", "eve2"):
        crowd.enter(member, member[:3])
    assert (crowd.size(), crowd.size("eve"), crowd.size("bob")) == (3, 2, 0)
    assert (crowd.quietest(), crowd.quietest("ann"), crowd.quietest("bob")) == ("eve1", "ann1", None)
    crowd.stir("eve1")
    assert (crowd.quietest(), crowd.quietest("eve"), crowd.size("eve")) == ("ann1", "eve2", 2)
    crowd.rest("eve1")
    crowd.leave("ann1")
    assert (crowd.quietest(), crowd.size(), crowd.size("ann")) == ("eve2", 2, 0)
    for call in (crowd.leave, crowd.stir, crowd.rest):  # of one that has left
        call("ann1")
    crowd.stir("eve2")
    crowd.stir("eve1")
    assert (crowd.quietest(), crowd.quietest("eve"), crowd.size()) == (None, None, 2)
    crowd.leave("eve1")
    crowd.leave("eve2")
    assert (crowd.size(), crowd.size("eve")) == (0, 0)


def test_few_requests_of_one_client_begin_at_once() -> None:
    async def scenario() -> None:
        requests = Clients(Pace(2, NEVER_S, 3))
        await requests.asks("eve1", "eve2", "eve3", "eve4", "eve5", "eve6", "ann1")
        assert requests.begun == ["eve1", "eve2", "ann1"]
        assert (requests.refusal("eve6").status, requests.refusal("eve6").reason) == (429, "own_requests")
        await requests.goes("eve3")
        await requests.ends("eve2", "ann1")
        assert requests.begun == ["eve1", "eve2", "ann1", "eve4"]
        await requests.ends("eve1", "eve4", "eve5")
        await requests.asks("eve7", "eve8", "eve9")
        assert requests.begun[-2:] == ["eve7", "eve8"]
        await requests.ends("eve7", "eve8", "eve9")

    asyncio.run(scenario())


async def pass_time(seconds: float) -> None:
    """Put the clock of the loop forward, which alone lets moments pass: the machine's may, wherever a test has to wait
    for a core.
    """
    loop = asyncio.get_running_loop()
    now = loop.time
    loop.time = lambda: now() + seconds  # type: ignore[method-assign]
    await settle()


def test_a_request_that_waits_for_something_holds_up_no_other() -> None:
    async def scenario() -> None:
        requests = Clients(Pace(1, NEVER_S, 10))
        await requests.asks("eve1", "eve2", "eve3")
        assert requests.begun == ["eve1"]
        for number in (2, 3):
            await pass_time(NEVER_S)
            assert requests.begun[1:] == ["eve2", "eve3"][: number - 1]
        await requests.ends("eve1", "eve2", "eve3")
        await requests.asks("eve4", "eve5")
        assert requests.begun[3:] == ["eve4"]
        await requests.ends("eve4", "eve5")

    asyncio.run(scenario())


@contextmanager
def suspended(web: Service) -> Iterator[None]:
    """The web process stands still, while the system takes what is sent to it."""
    os.kill(web.process.pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(web.process.pid, signal.SIGCONT)


def test_a_newcomer_does_not_wait_behind_every_connection(start_service: StartService) -> None:
    """Each of them took a turn of the event loop, in which the requests of all others went on."""
    web = start_service("web")
    others = [web.connect() for _ in range(10)]
    crowd: list[socket.socket] = []
    for other in others:
        other.sendall(LIVE)
        assert other.recv(15) == b"HTTP/1.1 200 OK"
    with suspended(web):
        for other in others:
            other.sendall(100 * LIVE)
        crowd = [web.connect() for _ in range(400)]
        newcomer = web.connect()
        newcomer.sendall(b"GET /metrics HTTP/1.1\r\nHost: test\r\nConnection: close\r\n\r\n")
    text = b""
    while data := newcomer.recv(65536):
        text += data
    for connection in (*others, *crowd, newcomer):
        connection.close()
    answered = re.search(rb'sgmethod_requests_total\{method="GET",route="/livez",status="200"\} ([0-9.]+)', text)
    assert answered is not None
    assert float(answered[1]) < 400  # of 1,000: 100, where it were 790


def cpu_s_of(web: Service) -> float:
    fields = Path(f"/proc/{web.process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def cpu_s_of_newcomers(web: Service, present: int) -> float:
    """What a thousand more connections cost, each of which takes the place of another."""
    crowd = [web.connect() for _ in range(present)]
    cpu_s = cpu_s_of(web)
    crowd += [web.connect() for _ in range(1000)]
    crowd[-1].sendall(LIVE)
    assert crowd[-1].recv(15) == b"HTTP/1.1 200 OK"
    cpu_s = cpu_s_of(web) - cpu_s
    for connection in crowd:
        connection.close()
    return cpu_s


def test_a_newcomer_costs_the_same_however_many_there_are(start_service: StartService) -> None:
    """It was compared with each that was there: 14 times the processor time beside 1,000 as beside 10."""
    of_few, of_many = (
        cpu_s_of_newcomers(start_service("web", max_connections=n, max_connections_per_address=n), n)
        for n in (10, 1000)
    )
    assert of_many < 3 * of_few


def test_pictures_from_memory_count_as_on_their_way(start_service: StartService) -> None:
    """One client asked for the same picture over many connections, and others got none any more."""
    web = start_service("web", max_answer_bytes=60_000_000)
    path = f"/decode/{web.published(PICTURE)}.png"
    size = len(web.client.get(f"{path}?scale=16").content)  # which is in memory from now on
    assert 12_000_000 < size < 15_000_000  # more than a connection holds
    crowd = [web.connect() for _ in range(6)]
    try:
        for connection in crowd:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            connection.sendall(f"GET {path}?scale=16 HTTP/1.1\r\nHost: test\r\n\r\n".encode())
        statuses = [connection.recv(12)[-3:] for connection in crowd]
        with httpx.Client(base_url=web.url, transport=httpx.HTTPTransport(local_address=OTHER), timeout=100) as other:
            assert other.get(path).status_code == 200
        assert (statuses.count(b"200"), statuses.count(b"429")) == (3, 3)  # half, and what goes beyond it
    finally:
        for connection in crowd:
            connection.close()
