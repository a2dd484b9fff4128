"""The web process: the application behind uvicorn."""

from __future__ import annotations

import asyncio
import ctypes
import resource
import signal
import socket
from types import FrameType

import uvicorn

import sgmethod
from service.settings import Settings, available_cores
from service.web.app import create_app
from service.web.guards.connections import ConnectionLimits, limited_connections

KEEP_ALIVE_S = 10
# glibc's malloc.h. Memory of a picture that was sent goes back to the system only beyond these.
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
KEPT_BYTES, LARGE_BYTES = 16 << 20, 4 << 20


def run_web(settings: Settings, listener: socket.socket) -> None:
    """Serve until SIGTERM or SIGINT, then finish what has begun within the grace time."""
    # A picture takes a few milliseconds on one thread. A second one shortens the worst of them, when an encode has the
    # other core (p99 of GET /decode 53 -> 32 ms on two cores); more would only get in the encoders' way.
    sgmethod.set_threads(min(2, available_cores()))
    limits = ConnectionLimits(
        settings.max_connections, settings.max_header_bytes, settings.header_timeout_s, settings.send_timeout_s
    )
    stopping = asyncio.Event()
    config = uvicorn.Config(
        create_app(settings, stopping),
        http=limited_connections(limits),
        ws="none",
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_keep_alive=KEEP_ALIVE_S,
        timeout_graceful_shutdown=max(1, int(settings.stop_grace_s / 2)),
    )
    server = _Server(config, stopping)
    for number in (signal.SIGTERM, signal.SIGINT):
        # These handlers hold until uvicorn sets its own, and again when it has stopped and raises the signal once
        # more. An end that was asked for is no failure.
        signal.signal(number, server.handle_exit)
    _allow_many_files()
    _keep_freed_memory()
    server.run(sockets=[listener])


def _allow_many_files() -> None:
    """As many descriptors as the system lets us have: connections, uploads and the job table all take some."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def _keep_freed_memory() -> None:
    """Keep what a request has freed for the next one.

    Every request takes a few megabytes. To get them from the system each time took 2.4 of the 6.0 ms of the PNG of
    768x512.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:  # another C library than glibc may have none
        mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
        mallopt(M_MMAP_THRESHOLD, LARGE_BYTES)


class _Server(uvicorn.Server):
    """Tells the application at once that it is to stop: streams would hold up the end."""

    def __init__(self, config: uvicorn.Config, stopping: asyncio.Event) -> None:
        super().__init__(config)
        self._stopping = stopping

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self._stopping.set()
        super().handle_exit(sig, frame)
