"""Attackers, in a process of their own: attackers.py NAME HOST:PORT SECONDS JOB

They come from addresses of their own, and send the next request as soon as they have an answer. JOB: a job whose
picture they may fetch. Prints "ready" once their files are made, and the statuses of all answers as JSON at the end.
The process runs at a low priority, because real attackers would use the cores of other machines.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import os
import resource
import sys
import time
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass

import numpy as np
from PIL import Image

from tests.support.attacks import crowded_bitstream, jpeg_of_many_markers, png_of_many_chunks, tiff_of_many_strips
from tests.support.pictures import SMALL, saved

NICENESS = 19
HOST = "Host: localhost\r\n"
TIMEOUT_S = 60.0
PAUSE_S = 0.05  # after a connection that was refused: this machine has few ports
UPLOAD_BYTES = 64 << 20
DRIP_BYTES, DRIP_S = 2100, 1.0  # just above the slowest upload that is allowed
HOPELESS = ("bytes=17", "quality=50&profile=paper", "gaussians=10000000", "psnr=nan", "bpp=1e999", "bpp=-1")
Request = Callable[["Crowd", str], Awaitable[str]]


@dataclass(frozen=True)
class Attack:
    """An attack. words: its description; at_once: the number of attackers, and addresses that of their addresses;
    request: makes the request that each repeats, and that returns a status or a word."""

    words: str
    at_once: int
    request: Callable[[], Request]
    addresses: int = 1


async def status_of(reader: asyncio.StreamReader) -> str:
    """The status in the first line of an answer."""
    return (await reader.readline()).split()[1].decode()


class Crowd:
    """The attackers of one service, for a number of seconds from when they are ready."""

    def __init__(self, address: str, job: str, seconds: float) -> None:
        self.host, _, port = address.rpartition(":")
        self.port = int(port)
        self.job = job
        self._seconds = seconds
        self._until = 0.0
        self.answers: Counter[str] = Counter()

    async def attack(self, attack: Attack) -> None:
        """Attack by all at once."""
        sources = [f"127.66.{n // 250}.{n % 250 + 1}" for n in range(attack.addresses)]
        request = attack.request()
        os.nice(NICENESS)
        print("ready", flush=True)
        self._until = time.monotonic() + self._seconds
        crowd = zip(range(attack.at_once), itertools.cycle(sources), strict=False)
        await asyncio.gather(*(self._go_on(request, source) for _, source in crowd))

    async def _go_on(self, request: Request, source: str) -> None:
        while (left_s := self._until - time.monotonic()) > 0:
            try:
                async with asyncio.timeout(min(left_s, TIMEOUT_S)):
                    self.answers[await request(self, source)] += 1
            except TimeoutError:
                self.answers["open at the end"] += 1
            except (OSError, asyncio.IncompleteReadError, IndexError, ValueError):
                self.answers["cut off"] += 1
                await asyncio.sleep(PAUSE_S)

    @contextlib.asynccontextmanager
    async def connection(self, source: str) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
        """A connection, closed with the context."""
        reader, writer = await asyncio.open_connection(self.host, self.port, local_addr=(source, 0))
        try:
            yield reader, writer
        finally:
            writer.close()

    async def asked(self, source: str, head: str, body: bytes = b"") -> tuple[str, bytes]:
        """Status and text of the answer."""
        async with self.connection(source) as (reader, writer):
            length = f"Content-Length: {len(body)}\r\n" if body else ""
            writer.write(f"{head} HTTP/1.1\r\n{HOST}Content-Type: image/*\r\nConnection: close\r\n".encode())
            writer.write(length.encode() + b"\r\n")
            with contextlib.suppress(ConnectionError):  # refused before the body was read: the answer is there
                writer.write(body)
                await writer.drain()
            return await status_of(reader), await reader.read()

    async def post(self, source: str, path: str, body: bytes) -> str:
        """The status of the answer to a POST."""
        return (await self.asked(source, f"POST {path}", body))[0]


def posting(path: str, make: Callable[[], bytes]) -> Callable[[], Request]:
    """Post the same file again and again."""

    def prepared() -> Request:
        body = make()
        return lambda crowd, source: crowd.post(source, path, body)

    return prepared


def plain_tiff() -> bytes:
    """An ordinary TIFF, almost as large as an upload may be."""
    pixels = np.random.default_rng(0).integers(0, 256, (4600, 4600, 3), np.uint8)
    return saved(Image.fromarray(pixels), "TIFF")


def large_pictures() -> Request:
    """Post pictures that are accepted, and cancel the jobs."""
    body = plain_tiff()

    async def post(crowd: Crowd, source: str) -> str:
        status, answer = await crowd.asked(source, "POST /encode", body)
        if status == "202":
            job = json.loads(answer.partition(b"\r\n\r\n")[2])["id"]
            await crowd.asked(source, f"DELETE /jobs/{job}")
        return status

    return post


def hopeless() -> Request:
    """Submit jobs that cannot succeed."""
    queries = itertools.cycle(HOPELESS)
    return lambda crowd, source: crowd.post(source, f"/encode?{next(queries)}", SMALL)


def idle() -> Request:
    """Open connections, and send nothing."""

    async def connect(crowd: Crowd, source: str) -> str:
        async with crowd.connection(source) as (reader, _):
            answer = await reader.readline()
            return answer.split()[1].decode() if answer else "closed"

    return connect


def slow_uploads() -> Request:
    """Send bodies as slowly as is allowed."""

    async def drip(crowd: Crowd, source: str) -> str:
        async with crowd.connection(source) as (reader, writer):
            head = f"POST /encode HTTP/1.1\r\n{HOST}Content-Type: image/*\r\nContent-Length: {UPLOAD_BYTES}\r\n\r\n"
            writer.write(head.encode())
            answer = asyncio.ensure_future(reader.readline())
            while not answer.done():
                writer.write(bytes(DRIP_BYTES))
                await asyncio.wait([answer], timeout=DRIP_S)
            return answer.result().split()[1].decode()

    return drip


def untaken() -> Request:
    """Ask for large pictures, and do not read them."""

    async def ask(crowd: Crowd, source: str) -> str:
        async with crowd.connection(source) as (reader, writer):
            writer.transport.pause_reading()  # type: ignore[attr-defined]
            writer.write(f"GET /decode/{crowd.job}.png?scale=8 HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
            await asyncio.sleep(TIMEOUT_S / 2)
            writer.transport.resume_reading()  # type: ignore[attr-defined]
            return await status_of(reader)

    return ask


TIFF, PNG, JPEG = 7_990_000, 5_590_000, 3_725_000  # as many as an upload may hold
ATTACKS = {
    "none": Attack("no attack", 0, idle),
    "tiff": Attack("TIFF of 8 million strips, 64 MB", 10, posting("/encode?bpp=1", lambda: tiff_of_many_strips(TIFF))),
    "png": Attack("PNG of 5.6 million chunks, 67 MB", 10, posting("/encode?bpp=1", lambda: png_of_many_chunks(PNG))),
    "jpeg": Attack(
        "JPEG of 3.7 million markers, 67 MB", 10, posting("/encode?bpp=1", lambda: jpeg_of_many_markers(JPEG))
    ),
    "large": Attack("pictures of 63 MB, accepted and cancelled", 10, large_pictures),
    "decode": Attack("files of 400,000 Gaussians on each other, decoded", 120, posting("/decode", crowded_bitstream)),
    "hopeless": Attack("jobs that cannot succeed", 100, hopeless),
    "idle": Attack("idle connections of one address", 10_100, idle),
    "idle-many": Attack("idle connections of 101 addresses", 10_100, idle, 101),
    "slow": Attack("uploads at 2 kB a second", 1000, slow_uploads),
    "untaken": Attack("large pictures that are not read", 1000, untaken),
}


def main() -> None:
    name, address, seconds, job = sys.argv[1:]
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    crowd = Crowd(address, job, float(seconds))
    asyncio.run(crowd.attack(ATTACKS[name]))
    print(json.dumps(dict(crowd.answers.most_common())))


if __name__ == "__main__":
    main()
