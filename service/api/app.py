"""The web process: the application with its context, routes and middleware, run by uvicorn.

Slow, crowded and malformed connections are the proxy's concern (docs/nginx.conf).
"""

from __future__ import annotations

import asyncio
import gc
import logging
import signal
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Collection
from contextlib import asynccontextmanager
from functools import cache
from ipaddress import ip_network
from pathlib import Path
from typing import Any

import uvicorn
from anyio import to_thread
from fastapi import FastAPI, Request, Security
from fastapi.security import HTTPBearer
from starlette.middleware.cors import CORSMiddleware
from starlette.responses import JSONResponse, Response
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Receive, Scope, Send

from service.api.context import Context, PictureCache
from service.api.gate import Authentication, BodyLimit, RequestLog
from service.api.health import Probes
from service.api.metrics import VERSION, Metrics
from service.api.problems import PAGE, install_problem_handlers
from service.api.routes import add_routes
from service.api.turns import ClientTasks, Shares
from service.keys import KeyRing
from service.logs import log_seldom
from service.opening import open_job_table, open_storage
from service.processes import BACKLOG, log_errors
from service.sandbox.client import Sandbox
from service.settings import Settings, listed

STATIC = Path(__file__).parents[1] / "page"
PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self';"
    " base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
FILE_POLICY = "default-src 'none'; script-src 'self'"
PICTURE_CACHE_BYTES = 64 << 20
MAX_UNREAD_BYTES = 256 << 20  # of files that clients have yet to read, and one more; one client may have half
KEYS_POLL_S = 1.0
STABLE_READS = 5  # times in a row: a file that is being written may end after any line
KEEP_ALIVE_S = 75  # longer than a proxy keeps connections, so that it does not send a request as one closes
FRESH_S = 10  # for which scripts need not be asked for again: the workers of a page import the same ones

log = logging.getLogger(__name__)


class PageFiles(StaticFiles):
    """Serves the files of the pages, with a Content-Security-Policy.

    A web worker that loads modules is subject to the policy of its own file in Firefox, and to the page's in Chromium.
    """

    def __init__(self, policy: str, **options: Any) -> None:
        super().__init__(**options)
        self._policy = policy

    def file_response(self, *args: Any, **options: Any) -> Response:
        response = super().file_response(*args, **options)
        response.headers["Content-Security-Policy"] = self._policy
        response.headers["Cache-Control"] = f"max-age={FRESH_S}"
        return response

    def page(self, name: str) -> Callable[[Request], Awaitable[Response]]:

        async def answer(request: Request) -> Response:
            response = await self.get_response(name, request.scope)
            del response.headers["Cache-Control"]  # the page itself is asked for each time
            return response

        return answer


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    context: Context = app.state.context
    # Objects that exist now are permanent. Searching them for garbage blocked the loop for 70 ms.
    gc.collect()
    gc.freeze()
    reloading = asyncio.create_task(_reload_keys(context))
    yield
    reloading.cancel()
    context.table.close()


async def _reload_keys(context: Context) -> None:
    """Reload the file of keys once it has changed and rests. If it cannot be read, the previous keys stay."""
    seen: dict[str, str] = {}
    same = 0
    while context.settings.api_keys_file is not None:
        await asyncio.sleep(KEYS_POLL_S)
        with log_errors("reloading the API keys"):
            try:
                names = await to_thread.run_sync(context.settings.read_keys)
            except ValueError as error:
                log_seldom(log, f"kept the previous API keys: {error}")
                names = {}
            seen, same = names, same + 1 if names == seen else 1
            if names and same >= STABLE_READS and context.keys.replace(names):
                log.info("reloaded the API keys")


def run_web(settings: Settings, sandbox: Sandbox, absent: Collection[str], listen: Callable[[], socket.socket]) -> None:
    """Serve until SIGTERM or SIGINT, then finish requests within the grace time.

    absent: layers that the sandbox lacks; listen: opens the socket, called once the application is complete. Raises
    JobTableError, MissingPackagesError, OSError.
    """
    proxies = listed(settings.trusted_proxies)
    config = uvicorn.Config(
        _application(settings, sandbox, Metrics(absent), lambda: server.should_exit),
        ws="none",
        log_config=None,
        access_log=False,
        backlog=BACKLOG,
        server_header=False,
        root_path=settings.root_path,
        proxy_headers=bool(proxies),
        forwarded_allow_ips=[*proxies, *map(_in_ipv6, proxies)],
        timeout_keep_alive=KEEP_ALIVE_S,
        timeout_graceful_shutdown=max(1, int(settings.stop_grace_s / 2)),
    )
    server = uvicorn.Server(config)
    for number in (signal.SIGTERM, signal.SIGINT):
        # Used until uvicorn sets its own handlers, and when it raises the signal again after stopping: a requested end
        # is not a failure.
        signal.signal(number, server.handle_exit)
    server.run(sockets=[listen()])


def _in_ipv6(proxy: str) -> str:
    """Return a network as a socket of IPv6 sees it: there, an IPv4 address is one of ::ffff:0:0/96."""
    network = ip_network(proxy)
    return proxy if network.version == 6 else f"::ffff:{network.network_address}/{96 + network.prefixlen}"


def _application(settings: Settings, sandbox: Sandbox, metrics: Metrics, stopping: Callable[[], bool]) -> ASGIApp:
    """Build the application with its middleware. stopping: returns whether the server is shutting down."""
    app = FastAPI(
        title="sgmethod",
        version=VERSION,
        description="Encode photographs as 2D Gaussians, and decode them.",
        lifespan=_lifespan,
        openapi_url=None,  # which would be serialised at each request, without a key
        servers=[{"url": settings.root_path}] if settings.root_path else None,
        docs_url=None,  # both pages load scripts from other hosts, which our policy forbids
        redoc_url=None,
        redirect_slashes=False,  # a redirect would repeat the client's Host
    )
    table, storage = open_job_table(settings), open_storage(settings)
    context = app.state.context = Context(
        settings,
        table,
        storage,
        ClientTasks(settings, sandbox, metrics),
        PictureCache(PICTURE_CACHE_BYTES),
        Shares(settings.max_waits, -(-settings.max_waits // 2)),
        Shares(MAX_UNREAD_BYTES, MAX_UNREAD_BYTES // 2),
        stopping,
        KeyRing(settings.key_names),
        metrics,
    )
    app.state.probes = Probes(table, storage)
    install_problem_handlers(app)
    # Authentication checks the key; this documents it.
    add_routes(app, [Security(HTTPBearer(auto_error=False))] if settings.key_names else [])
    decoder = PageFiles(FILE_POLICY, packages=[("sgmethod", "javascript/src")])  # with <sg-img>
    app.mount("/static/sgmethod", decoder)
    app.mount("/static", PageFiles(FILE_POLICY, directory=STATIC))
    pages = PageFiles(PAGE_POLICY, directory=STATIC)
    for path, file in (("/", "index.html"), (PAGE, "docs.html")):
        app.add_api_route(path, pages.page(file), include_in_schema=False)
    app.add_api_route("/openapi.json", _document(app), include_in_schema=False)
    return _with_middleware(app, context)


def _document(app: FastAPI) -> Callable[[], Response]:
    """Return the handler of the OpenAPI document, which the first request makes: at the start, others would wait."""
    body = cache(lambda: bytes(JSONResponse(app.openapi()).body))
    return lambda: Response(body(), media_type="application/json")


def _with_middleware(app: FastAPI, context: Context) -> ASGIApp:
    """Add the middleware for requests, from the inside out.

    It wraps FastAPI, because FastAPI's answer to an unexpected error bypasses its own middleware.
    """
    settings = context.settings
    http: ASGIApp = Authentication(app, context.keys, settings)
    # Where a bucket stores images, temporary files are alone on their disk, which may be small.
    http = BodyLimit(http, settings.max_upload_bytes, 0 if settings.storage_url else settings.min_free_bytes)
    if settings.cors_origins:
        http = CORSMiddleware(
            http,
            allow_origins=listed(settings.cors_origins),
            allow_methods=["GET", "HEAD", "POST", "DELETE"],
            allow_headers=[
                *("Authorization", "Idempotency-Key", "If-None-Match", "X-Request-Id"),
                *("traceparent", "tracestate"),  # which a page with OpenTelemetry sends with every request
            ],
            expose_headers=["ETag", "Location", "Retry-After", "X-Request-Id"],
        )
    http = RequestLog(http, context.metrics)

    async def application(scope: Scope, receive: Receive, send: Send) -> None:
        await (http if scope["type"] == "http" else app)(scope, receive, send)

    return application
