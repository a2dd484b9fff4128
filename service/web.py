"""The web process: the application behind uvicorn."""

from __future__ import annotations

import signal
import socket

import uvicorn

import sgmethod
from service.app import create_app
from service.settings import Settings

KEEP_ALIVE_S = 10


def run_web(settings: Settings, listener: socket.socket) -> None:
    """Serve until SIGTERM or SIGINT, then finish what has begun within the grace time."""
    # One thread decodes a picture in a few milliseconds; more would only get in the encoders' way.
    sgmethod.set_threads(1)
    config = uvicorn.Config(
        create_app(settings),
        http="httptools",
        ws="none",
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_keep_alive=KEEP_ALIVE_S,
        timeout_graceful_shutdown=max(1, int(settings.stop_grace_s / 2)),
    )
    for wanted_end in (signal.SIGTERM, signal.SIGINT):
        # uvicorn raises the signal again once it has stopped; a wished end is not a failure.
        signal.signal(wanted_end, lambda _number, _frame: None)
    uvicorn.Server(config).run(sockets=[listener])
