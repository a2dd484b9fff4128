"""What an encode gets of a core beside the pictures of one client, and beside whatever else the machine does."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx2
import pytest

from tests.support.data import PICTURE
from tests.support.pictures import noisy_png
from tests.support.processes import NAME_LENGTH, TIMEOUT_S, wait_until
from tests.support.service import Service

pytestmark = pytest.mark.thorough

MEASURED_S = 10.0  # of processor time. In as long by the clock, a busy machine may do no more than begin two pictures
FAIR = 0.2  # of what an encode and two pictures get; by equal weights it would be a third
BUSY = "import os\nos.nice(19)\nwhile True:\n    pass"


@contextlib.contextmanager
def one_core() -> Iterator[None]:
    """Give one core to what is started within, and somebody else work on it."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    other = subprocess.Popen([sys.executable, "-c", BUSY])
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)
        other.kill()
        other.wait()


def processor_times(service: Service, job_id: str) -> dict[tuple[str, int], float]:
    """Seconds that each encode and picture has had of processors, by kind and number of its process."""
    kinds, found = {job_id[:NAME_LENGTH]: "encode", "draw": "picture"}, {}
    for number, one in service.family().items():
        if one.name in kinds:
            with contextlib.suppress(OSError):  # it has ended
                found[kinds[one.name], number] = time.clock_gettime(~number << 3 | 2)  # as clock_getcpuclockid() has it
    return found


def test_pictures_of_one_client_leave_an_encode_its_share(tmp_path: Path) -> None:
    """Two at a time, each of some 0.4 s of a core: it got 5 % of it. 23 and 24 % seen, at loads of 5 and 9."""
    stopped = threading.Event()

    def draw() -> None:
        with httpx2.Client(base_url=service.url, timeout=TIMEOUT_S) as client:
            while not stopped.is_set():
                with contextlib.suppress(httpx2.TransportError):
                    client.post("/decode.avif?scale=64&texture=0", content=PICTURE)

    with one_core():
        service = Service(tmp_path / "data", workers=1, lease_s=60)
        with ThreadPoolExecutor(2) as pool, contextlib.ExitStack() as stack:
            stack.callback(service.kill_all)
            stack.callback(stopped.set)
            service.wait_ready()
            job_id = service.accepted(noisy_png(1024), bytes=40_000, effort=9, time_limit_s=300)
            wait_until(lambda: processor_times(service, job_id))
            before = processor_times(service, job_id)
            for _ in range(2):
                pool.submit(draw)
            seen: dict[tuple[str, int], float] = {}

            def total(kind: str = "") -> float:
                return sum(s - before.get(one, 0.0) for one, s in seen.items() if kind in one[0])

            def is_measured() -> bool:
                seen.update(processor_times(service, job_id))
                return total() >= MEASURED_S

            wait_until(is_measured)
            share = total("encode") / total()
    print("share", share, seen, before)
    assert FAIR <= share <= 0.6, seen
