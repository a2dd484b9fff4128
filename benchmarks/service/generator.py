"""Requests at fixed moments, however long the answers to earlier ones take.

A latency counts from the moment at which the request was due, so a service (or generator) that falls behind shows in
every request that had to wait. Load generators such as wrk send the next request only after an answer, and hide that.
"""

from __future__ import annotations

import asyncio
import sys
import time
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

TIMEOUT_S = 10.0
BUFFER_BYTES = 1 << 24  # a whole picture fits: a smaller buffer would stop and start reading for every 64 KiB
Connection = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@dataclass(frozen=True)
class Request:
    """A kind of request. rate: how many a second; path: {} in it stands for the number of the request."""

    rate: float
    method: str
    path: str
    body: bytes = b""


class Client:
    """An HTTP client with connections that are used again. source: the address that they come from."""

    def __init__(self, address: str, source: str | None) -> None:
        self._host, _, self._port = address.rpartition(":")
        self._source = (source, 0) if source else None
        self._idle: deque[Connection] = deque()

    async def ask(self, method: str, path: str, body: bytes) -> int:
        """The status of the answer, whose body has been read."""
        while self._idle:
            connection = self._idle.pop()
            try:
                return await self._ask_over(connection, method, path, body)
            except (ConnectionError, asyncio.IncompleteReadError):  # closed for being idle
                connection[1].close()
        opened = await asyncio.open_connection(self._host, self._port, limit=BUFFER_BYTES, local_addr=self._source)
        return await self._ask_over(opened, method, path, body)

    async def _ask_over(self, connection: Connection, method: str, path: str, body: bytes) -> int:
        reader, writer = connection
        length = f"Content-Type: image/*\r\nContent-Length: {len(body)}\r\n" if body else ""
        writer.write(f"{method} {path} HTTP/1.1\r\nHost: {self._host}\r\n{length}\r\n".encode() + body)
        head = (await reader.readuntil(b"\r\n\r\n")).lower().split(b"\r\n")
        await reader.readexactly(next((int(line[15:]) for line in head if line.startswith(b"content-length:")), 0))
        self._idle.append(connection)
        return int(head[0].split()[1])

    def close(self) -> None:
        """Close all connections."""
        for _, writer in self._idle:
            writer.close()


async def series(client: Client, request: Request, seconds: float) -> dict[str, Any]:
    """Send one kind of request; return quantiles of the latencies in milliseconds, and how many requests failed."""
    latencies: list[float] = []
    failures: Counter[str] = Counter()

    async def send(due: float, number: int) -> None:
        try:
            async with asyncio.timeout(TIMEOUT_S):
                status = await client.ask(request.method, request.path.replace("{}", f"{number:06}"), request.body)
            if status >= 400:
                failures[str(status)] += 1
        except (OSError, TimeoutError, asyncio.IncompleteReadError) as error:
            failures[type(error).__name__] += 1
        latencies.append(1e3 * (time.perf_counter() - due))

    began = time.perf_counter()
    async with asyncio.TaskGroup() as tasks:
        for number in range(int(request.rate * seconds)):
            due = began + number / request.rate
            await asyncio.sleep(max(0.0, due - time.perf_counter()))
            tasks.create_task(send(due, number))
    if failures:
        print(f"{request.method} {request.path}: {dict(failures)}", file=sys.stderr)
    p50, p99, slowest = (round(float(ms), 2) for ms in np.percentile(latencies, (50, 99, 100)))
    return {"requests": len(latencies), "failed": failures.total(), "p50_ms": p50, "p99_ms": p99, "max_ms": slowest}


def send_all(url: str, seconds: float, requests: Sequence[Request], source: str | None = None) -> list[dict[str, Any]]:
    """Send all kinds of requests at once; return what series() measured of each."""

    async def run() -> list[dict[str, Any]]:
        client = Client(url.removeprefix("http://"), source)
        found = await asyncio.gather(*(series(client, request, seconds) for request in requests))
        client.close()
        return list(found)

    return asyncio.run(run())
