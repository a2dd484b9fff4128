"""The web process: the application behind uvicorn."""

from __future__ import annotations

import asyncio
import gc
import resource
import signal
import socket
from collections.abc import Callable, Collection
from types import FrameType

import uvicorn

from service.process.listening import BACKLOG
from service.sandbox.client import Sandbox
from service.settings import Settings
from service.web.app import create_app
from service.web.guards.addresses import networks
from service.web.guards.connections import ConnectionLimits, limited_connections
from service.web.guards.metrics import Metrics

KEEP_ALIVE_S = 10
MAX_HEAD_BYTES = 32_768  # of a request line and headers
ACCEPTED_AT_ONCE = 16  # connections, in one turn of the event loop


def run_web(settings: Settings, sandbox: Sandbox, absent: Collection[str], listen: Callable[[], socket.socket]) -> None:
    """Serve until SIGTERM or SIGINT, then finish what has begun within the grace time.

    absent: layers of the sandbox that the system does not offer; listen is asked for the socket once the application
    has all that it needs: so its callers can rely on that.
    Raises JobTableError, MissingPackagesError, OSError.
    """
    limits = ConnectionLimits(
        settings.max_connections,
        settings.max_connections_per_address,
        networks(settings.trusted_proxies),
        MAX_HEAD_BYTES,
        settings.header_timeout_s,
        settings.send_timeout_s,
    )
    stopping, metrics = asyncio.Event(), Metrics()
    metrics.show_layers(absent)
    config = uvicorn.Config(
        create_app(settings, sandbox, metrics, stopping),
        http=limited_connections(limits, metrics),
        ws="none",
        log_config=None,
        access_log=False,
        backlog=BACKLOG,
        server_header=False,
        proxy_headers=bool(settings.trusted_proxies),
        forwarded_allow_ips=settings.trusted_proxies,
        timeout_keep_alive=KEEP_ALIVE_S,
        timeout_graceful_shutdown=max(1, int(settings.stop_grace_s / 2)),
    )
    server = _Server(config, stopping)
    for number in (signal.SIGTERM, signal.SIGINT):
        # These handlers hold until uvicorn sets its own, and again when it has stopped and raises the signal once
        # more. An end that was asked for is no failure.
        signal.signal(number, server.handle_exit)
    _allow_many_files()
    listener = listen()
    # uvloop accepts one connection of a socket in each turn. A newcomer would wait for as many turns, in which others
    # are answered, as there are connections before it; limits hold once they are accepted. So it has many sockets.
    server.run(sockets=[listener, *(listener.dup() for _ in range(ACCEPTED_AT_ONCE - 1))])


def _allow_many_files() -> None:
    """As many descriptors as the system lets us have: connections, uploads and the job table all take some."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


class _Server(uvicorn.Server):
    """Tells the application at once that it is to stop: streams would hold up the end."""

    def __init__(self, config: uvicorn.Config, stopping: asyncio.Event) -> None:
        super().__init__(config)
        self._stopping = stopping

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        # What is there now stays. Looking through all of it for garbage again and again held the loop for 70 ms each.
        gc.collect()
        gc.freeze()

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self._stopping.set()
        super().handle_exit(sig, frame)
