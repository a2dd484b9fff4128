"""The web process: the application behind uvicorn.

Slow, crowded and malformed connections are the proxy's concern (docs/nginx.conf).
"""

from __future__ import annotations

import signal
import socket
from collections.abc import Callable, Collection

import uvicorn

from service.api.app import create_app
from service.api.metrics import Metrics
from service.process.supervisor import BACKLOG
from service.sandbox.client import Sandbox
from service.settings import Settings

KEEP_ALIVE_S = 75  # longer than a proxy keeps its connections: a request must not meet one that closes


def run_web(settings: Settings, sandbox: Sandbox, absent: Collection[str], listen: Callable[[], socket.socket]) -> None:
    """Serve until SIGTERM or SIGINT, then finish what has begun within the grace time.

    absent: layers that the sandbox lacks. listen is asked for the socket once the application has all that it needs: so
    its callers can rely on that.
    Raises JobTableError, MissingPackagesError, OSError.
    """
    metrics = Metrics()
    metrics.show_layers(absent)
    config = uvicorn.Config(
        create_app(settings, sandbox, metrics, lambda: server.should_exit),
        ws="none",
        log_config=None,
        access_log=False,
        backlog=BACKLOG,
        server_header=False,
        root_path=settings.root_path,
        proxy_headers=bool(settings.trusted_proxies),
        forwarded_allow_ips=settings.trusted_proxies,
        timeout_keep_alive=KEEP_ALIVE_S,
        timeout_graceful_shutdown=max(1, int(settings.stop_grace_s / 2)),
    )
    server = uvicorn.Server(config)
    for number in (signal.SIGTERM, signal.SIGINT):
        # These handlers hold until uvicorn sets its own, and again when it has stopped and raises the signal once
        # more. An end that was asked for is no failure.
        signal.signal(number, server.handle_exit)
    server.run(sockets=[listen()])
