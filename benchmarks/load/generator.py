"""The load of benchmarks.load, in a process of its own: GET requests at fixed moments, whatever came of those before.

    python -m benchmarks.load.generator HOST:PORT SECONDS RATE=PATH...     prints latencies as JSON

A latency counts from the moment at which the request was due, so a server (or a generator) that falls behind shows
in every request that had to wait. A plain client over asyncio's streams: the cores are shared with the server.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from collections import deque

TIMEOUT_S = 10.0
BUFFER_BYTES = 1 << 24
Connection = tuple[asyncio.StreamReader, asyncio.StreamWriter]


class Client:
    """Keeps connections and uses them again."""

    def __init__(self, address: str) -> None:
        self._host, _, port = address.rpartition(":")
        self._port = int(port)
        self._idle: deque[Connection] = deque()

    async def get(self, path: str) -> int:
        """The status of the answer, whose body has been read whole."""
        reader, writer = await self._connection()
        writer.write(f"GET {path} HTTP/1.1\r\nHost: {self._host}\r\n\r\n".encode())
        head = await reader.readuntil(b"\r\n\r\n")
        lines = head.lower().split(b"\r\n")
        length = next(int(line.split(b":")[1]) for line in lines if line.startswith(b"content-length:"))
        await reader.readexactly(length)
        self._idle.append((reader, writer))
        return int(lines[0].split()[1])

    async def _connection(self) -> Connection:
        """One that the server has not closed for being idle, or a new one."""
        while self._idle:
            reader, writer = self._idle.pop()
            if not reader.at_eof():
                return reader, writer
            writer.close()
        # A whole picture fits: a smaller buffer would stop and start reading for every 64 KiB.
        return await asyncio.open_connection(self._host, self._port, limit=BUFFER_BYTES)

    def close(self) -> None:
        """Let go of all connections."""
        for _, writer in self._idle:
            writer.close()


async def series(client: Client, path: str, rate: float, seconds: float) -> dict[str, object]:
    """Latencies in milliseconds of requests that are due `rate` times a second, and how many failed."""
    latencies: list[float] = []
    statuses: list[int] = []

    async def one(due: float) -> None:
        try:
            async with asyncio.timeout(TIMEOUT_S):
                statuses.append(await client.get(path))
        except (OSError, TimeoutError, asyncio.IncompleteReadError) as error:
            print(f"{path}: {error!r}", file=sys.stderr)
            statuses.append(0)
        latencies.append(1e3 * (time.perf_counter() - due))

    began = time.perf_counter()
    async with asyncio.TaskGroup() as tasks:
        for number in range(int(rate * seconds)):
            due = began + number / rate
            await asyncio.sleep(max(0.0, due - time.perf_counter()))
            tasks.create_task(one(due))
    return {"path": path, "ms": latencies, "failed": sum(status != 200 for status in statuses)}


async def run(address: str, seconds: float, wanted: list[tuple[float, str]]) -> list[dict[str, object]]:
    """All series at once."""
    client = Client(address)
    done = await asyncio.gather(*(series(client, path, rate, seconds) for rate, path in wanted))
    client.close()
    return list(done)


def main() -> None:
    """The command."""
    address, seconds, *texts = sys.argv[1:]
    wanted = [(float(rate), path) for rate, _, path in (text.partition("=") for text in texts)]
    print(json.dumps(asyncio.run(run(address, float(seconds), wanted))))


if __name__ == "__main__":
    main()
