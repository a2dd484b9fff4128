"""Clients that make the service work hard: it stops in time, and everybody else is served meanwhile."""

from __future__ import annotations

import os
import re
import select
import signal
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx2
import pytest

from tests.support.attacks import crowded_bitstream, jpeg_of_many_markers, png_of_many_chunks, tiff_of_many_strips
from tests.support.data import PICTURE
from tests.support.pictures import SMALL
from tests.support.processes import NAME_LENGTH, processes, wait_until
from tests.support.service import Service, StartService, assert_problem, bearer, keys_of

pytestmark = pytest.mark.thorough

NEVER_S = 10_000  # a limit that no test reaches
START_CPU_S = 0.3  # more than one takes to start


@pytest.fixture(scope="module")
def web(start_for_module: StartService) -> Service:
    """A web process with two keys, whose decodes may take as long as they like."""
    return start_for_module("web", queue_length=10_000, api_keys=keys_of("eve", "ann"), decode_time_s=NEVER_S)


@pytest.fixture(scope="module")
def crowded() -> bytes:
    """A bitstream that takes seconds to draw."""
    return crowded_bitstream()


@pytest.fixture
def eve(web: Service) -> Iterator[httpx2.Client]:
    """The attacker."""
    with httpx2.Client(base_url=web.url, headers=bearer("eve"), timeout=100) as client:
        yield client


@pytest.fixture
def ann(web: Service) -> Iterator[httpx2.Client]:
    """Somebody else."""
    with httpx2.Client(base_url=web.url, headers=bearer("ann"), timeout=100) as client:
        yield client


def posted(client: httpx2.Client, image: bytes) -> httpx2.Response:
    return client.post("/encode?bpp=1", content=image, headers={"Content-Type": "image/*"})


def forks_of(service: Service, name: str) -> set[int]:
    """The sandbox's processes that do a kind of task, or wait for one."""
    return {number for number, process in service.family().items() if process.name == name[:NAME_LENGTH]}


def state_and_cpu_s_of(number: int) -> tuple[str, float]:
    """The state of a process, as "R" for one that computes, and the seconds of a core that it has taken."""
    fields = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()
    return fields[0], (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def cpu_s_and_peak_bytes_of(service: Service) -> tuple[float, int]:
    """What the web process itself has taken: seconds of a core, and memory at most."""
    number = service.process.pid
    peak = re.search(r"VmHWM:\s*(\d+)", Path(f"/proc/{number}/status").read_text())
    return state_and_cpu_s_of(number)[1], 1024 * int(peak[1])


@pytest.mark.parametrize(
    ("make", "parts"),
    [(tiff_of_many_strips, 2_400_000), (png_of_many_chunks, 1_000_000), (jpeg_of_many_markers, 3_500_000)],
)
def test_a_header_that_takes_long_is_given_up(
    web: Service, eve: httpx2.Client, ann: httpx2.Client, make: Callable[[int], bytes], parts: int
) -> None:
    """It took the web process 0.8 to 2.7 s, and up to 280 MB; others waited up to 7 s."""
    image = make(parts)
    posted(ann, SMALL)
    cpu_s, peak = cpu_s_and_peak_bytes_of(web)
    assert_problem(posted(eve, image), 422, "exceeds the time limit")
    after_s, later = cpu_s_and_peak_bytes_of(web)
    assert after_s - cpu_s < 0.5  # to take in up to 63 MB
    assert later - peak < 2 * len(image) + 20e6
    assert posted(ann, SMALL).status_code == 202


def test_slow_headers_delay_no_other_client(eve: httpx2.Client, ann: httpx2.Client) -> None:
    image = tiff_of_many_strips(2_400_000)
    with ThreadPoolExecutor(4) as pool:
        attack = [pool.submit(posted, eve, image) for _ in range(4)]
        while not any(attempt.done() for attempt in attack):
            assert posted(ann, SMALL).status_code == 202
        assert not all(attempt.done() for attempt in attack)
        assert {attempt.result().status_code for attempt in attack} == {422}


def sent_by_eve(web: Service, bitstream: bytes) -> socket.socket:
    """A connection over which eve has posted a bitstream to be decoded."""
    connection = web.connect()
    head = (
        f"POST /decode HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer eve\r\nContent-Length: {len(bitstream)}\r\n"
    )
    connection.sendall(head.encode() + b"\r\n" + bitstream)
    return connection


def is_answered(connection: socket.socket) -> bool:
    return bool(select.select([connection], [], [], 0)[0])


def test_decodes_of_one_client_keep_no_other_waiting(web: Service, ann: httpx2.Client, crowded: bytes) -> None:
    """Twelve of them held another key's POST /encode for 21 s, and its POST /decode for 26 s."""
    attack = [sent_by_eve(web, crowded) for _ in range(12)]
    try:
        wait_until(lambda: len(forks_of(web, "draw")) >= 2)
        for _ in range(5):
            assert ann.post("/decode", content=PICTURE).status_code == 200
            assert posted(ann, SMALL).status_code == 202
        assert not all(map(is_answered, attack))
    finally:
        for connection in attack:
            connection.close()
    wait_until(lambda: not forks_of(web, "draw"))


def test_a_decode_ends_when_its_client_disconnects(web: Service, crowded: bytes) -> None:
    """It is stopped here, and could not end by itself."""

    def left_in_the_middle() -> int | None:
        with sent_by_eve(web, crowded) as connection:
            busy = busy_fork(web, lambda: not is_answered(connection))
            if busy is not None:
                os.kill(busy, signal.SIGSTOP)  # so that it does not end before its client goes
            return busy

    busy = wait_until(left_in_the_middle)
    wait_until(lambda: busy not in processes())


def is_busy(number: int) -> bool:
    """Whether a task computes just now, and has for longer than its start takes."""
    try:
        state, cpu_s = state_and_cpu_s_of(number)
    except OSError:
        return False
    return state == "R" and cpu_s > START_CPU_S


def busy_fork(web: Service, goes_on: Callable[[], bool]) -> int | None:
    """The one that computes; None if what it is to do was over before it was seen, as where a test had to wait for a
    core meanwhile. Then it can be asked for again.
    """
    busy = wait_until(lambda: [n for n in forks_of(web, "draw") if is_busy(n)] or not goes_on())
    return busy[0] if isinstance(busy, list) else None


@pytest.mark.parametrize(
    ("setting", "gaussians", "limit"),
    [({"decode_time_s": 0.5}, 400_000, "time"), ({"job_memory_bytes": 2**28}, 1, "memory")],  # 147 MB of pixels
)
def test_a_decode_has_limits(
    start_service: StartService, setting: dict[str, float], gaussians: int, limit: str
) -> None:
    web = start_service("web", **setting)
    refused = web.client.post("/decode", content=crowded_bitstream(gaussians))
    assert_problem(refused, 422, f"exceeds the {limit} limit")
    assert web.client.post("/decode", content=PICTURE).status_code == 200


def test_a_task_that_is_killed_harms_no_other(start_service: StartService, crowded: bytes) -> None:
    """It is tried again; a file that its reader dies of twice is given up."""
    web = start_service("web", decode_time_s=NEVER_S)
    assert web.client.post("/decode", content=PICTURE).status_code == 200
    waiting = forks_of(web, "waits for a task")
    for number in waiting:
        os.kill(number, 9)
    wait_until(lambda: not {*waiting} & processes().keys())  # else the next task is given to one that is dying
    assert web.client.post("/decode", content=PICTURE).status_code == 200

    def killed_twice() -> httpx2.Response | None:
        answer = pool.submit(web.client.post, "/decode", content=crowded)
        for _ in range(2):
            busy = busy_fork(web, lambda: not answer.done())
            if busy is None:
                return None
            os.kill(busy, 9)
            wait_until(lambda: busy not in processes())  # noqa: B023
        return answer.result()

    with ThreadPoolExecutor(1) as pool:
        refused = wait_until(killed_twice)
    assert refused is not None
    assert_problem(refused, 503, "out of memory")
    assert web.client.post("/decode", content=PICTURE).status_code == 200
