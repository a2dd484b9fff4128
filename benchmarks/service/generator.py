"""Requests at fixed moments, however long the answers before them take, in a process of its own.

    python -m benchmarks.service.generator HOST:PORT SECONDS [--from ADDRESS] 'RATE METHOD PATH [FILE]'...

prints latencies as JSON. FILE: the body. A latency counts from the moment at which the request was due, so a server (or
a generator) that falls behind shows in every request that had to wait; wrk waits with it. A plain client over asyncio's
streams, as the server has the same cores.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import subprocess
import sys
import time
from collections import Counter, deque
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness.data import ROOT

TIMEOUT_S = 10.0
BUFFER_BYTES = 1 << 24
Connection = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@dataclass(frozen=True)
class Request:
    """One kind of request, and how often a second it is made; {} in its path stands for how often it was before."""

    rate: float
    method: str
    path: str
    body: bytes = b""

    @classmethod
    def from_text(cls, text: str) -> Request:
        """Read an argument of the command line."""
        rate, method, path, *file = text.split()
        return cls(float(rate), method, path, Path(file[0]).read_bytes() if file else b"")


class Client:
    """A client that keeps connections and uses them again. source: the address that they come from."""

    def __init__(self, address: str, source: str | None = None) -> None:
        self._host, _, port = address.rpartition(":")
        self._port = int(port)
        self._source = source
        self._idle: deque[Connection] = deque()

    async def ask(self, request: Request) -> int:
        """The status of the answer, whose body has been read whole."""
        while self._idle:
            connection = self._idle.pop()
            try:
                return await self._asked(connection, request)
            except (ConnectionError, asyncio.IncompleteReadError):  # closed for being idle
                connection[1].close()
        # A whole picture fits: a smaller buffer would stop and start reading for every 64 KiB.
        source = None if self._source is None else (self._source, 0)
        opened = await asyncio.open_connection(self._host, self._port, limit=BUFFER_BYTES, local_addr=source)
        return await self._asked(opened, request)

    async def _asked(self, connection: Connection, request: Request) -> int:
        reader, writer = connection
        head = f"{request.method} {request.path} HTTP/1.1\r\nHost: {self._host}\r\n"
        if request.method == "POST":
            head += f"Content-Type: image/*\r\nContent-Length: {len(request.body)}\r\n"
        writer.write(head.encode() + b"\r\n" + request.body)
        answer = (await reader.readuntil(b"\r\n\r\n")).lower().split(b"\r\n")
        length = next((int(line.split(b":")[1]) for line in answer if line.startswith(b"content-length:")), 0)
        await reader.readexactly(length)
        self._idle.append(connection)
        return int(answer[0].split()[1])

    def close(self) -> None:
        """Let go of all connections."""
        for _, writer in self._idle:
            writer.close()


async def series(client: Client, request: Request, seconds: float) -> dict[str, object]:
    """Latencies in milliseconds of requests that are due `rate` times a second, and how many failed."""
    latencies: list[float] = []
    failures: Counter[str] = Counter()

    async def one(due: float, number: int) -> None:
        numbered = replace(request, path=request.path.replace("{}", f"{number:06}"))
        try:
            async with asyncio.timeout(TIMEOUT_S):
                status = await client.ask(numbered)
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
            tasks.create_task(one(due, number))
    if failures:
        print(f"{request.method} {request.path}: {dict(failures)}", file=sys.stderr)
    return {"ms": latencies, "failed": failures.total()}


async def run(client: Client, seconds: float, requests: list[Request]) -> list[dict[str, object]]:
    """Run all series at once."""
    done = await asyncio.gather(*(series(client, one, seconds) for one in requests))
    client.close()
    return list(done)


def spread(series: dict[str, Any]) -> dict[str, Any]:
    """Latencies of one series of requests, from what the generator printed."""
    p50, p99, most = (round(float(ms), 2) for ms in np.percentile(series["ms"], (50, 99, 100)))
    return {"requests": len(series["ms"]), "failed": series["failed"], "p50_ms": p50, "p99_ms": p99, "most_ms": most}


def generated(url: str, seconds: float, *requests: str, source: str | None = None) -> list[dict[str, Any]]:
    """What the generator measured, for each request."""
    origin = [] if source is None else ["--from", source]
    address = url.removeprefix("http://")
    command = [sys.executable, "-m", "benchmarks.service.generator", address, str(seconds), *origin, *requests]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    return [spread(series) for series in json.loads(done.stdout)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address")
    parser.add_argument("seconds", type=float)
    parser.add_argument("requests", nargs="+")
    parser.add_argument("--from", dest="source")
    options = parser.parse_args()
    client = Client(options.address, options.source)
    print(json.dumps(asyncio.run(run(client, options.seconds, [Request.from_text(text) for text in options.requests]))))


if __name__ == "__main__":
    main()
