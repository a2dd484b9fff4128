"""The web application: its parts, its routes, and what stands around them."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from anyio import to_thread
from fastapi import Depends, FastAPI, Security
from fastapi.security import HTTPBearer
from starlette.middleware.cors import CORSMiddleware
from starlette.responses import FileResponse, Response
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp

from service.keys import KeyRing
from service.opening import open_job_table, open_storage
from service.process.background import survived
from service.sandbox.client import Sandbox
from service.settings import Settings
from service.web.guards.access import AccessLog
from service.web.guards.gate import Gate
from service.web.guards.metrics import Metrics, RequestMetrics
from service.web.guards.middleware import (
    AnswerGuard,
    BodyGuard,
    BodyLimits,
    HeadAsGet,
    PacedRequests,
    ResponseHeaders,
    WithoutPrefix,
)
from service.web.guards.problems import install_problem_handlers, problems
from service.web.guards.shares import Shares
from service.web.guards.tasks import ClientTasks
from service.web.guards.turns import Turns
from service.web.routes import events as event_routes
from service.web.routes import health as health_routes
from service.web.routes import jobs as job_routes
from service.web.routes import pictures as picture_routes
from service.web.routes import previews as preview_routes
from service.web.routes.decoding import PictureCache
from service.web.routes.health import VERSION
from service.web.routes.parts import Parts, known_query, no_stray_body
from service.web.submitting.submission import MULTIPART_OVERHEAD_BYTES

STATIC = Path(__file__).with_name("static")
PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self';"
    " base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
FILE_POLICY = "default-src 'none'; script-src 'self'"
UPLOADS_IN_MEMORY = 4
MIN_UPLOAD_RATE = 2000  # bytes a second, on average
KEYS_POLL_S = 1.0

log = logging.getLogger(__name__)


class PageFiles(StaticFiles):
    """The files of the pages. A worker keeps to the policy of its own file, and has to load modules: Firefox holds it
    to that, Chromium to the page's.
    """

    def file_response(self, *args: Any, **options: Any) -> Response:
        response = super().file_response(*args, **options)
        response.headers["Content-Security-Policy"] = FILE_POLICY
        return response


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    parts: Parts = app.state.parts
    reloading = asyncio.create_task(_reload_keys(parts))
    yield
    reloading.cancel()
    parts.table.close()


async def _reload_keys(parts: Parts) -> None:
    """Follow the file of keys. What cannot be read leaves the keys as they were: nobody is let in by a mistake."""
    path = parts.settings.api_keys_file
    if path is None:
        return
    seen = await to_thread.run_sync(_version_of, path)
    while True:
        await asyncio.sleep(KEYS_POLL_S)
        with survived("reloading the API keys"):
            version = await to_thread.run_sync(_version_of, path)
            if version == seen:
                continue
            try:
                parts.keys.replace(await to_thread.run_sync(parts.settings.read_keys))
                log.info("reloaded the API keys")
            except ValueError as error:
                log.error("kept the previous API keys: %s", error)
                if isinstance(error.__cause__, OSError):  # which may pass: read it again
                    continue
            seen = version


def _version_of(path: Path) -> tuple[int, int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ctime_ns, found.st_ino, found.st_size


def _body_limits(settings: Settings) -> BodyLimits:
    return BodyLimits(
        settings.max_upload_bytes + MULTIPART_OVERHEAD_BYTES,
        settings.body_chunk_timeout_s,
        settings.body_timeout_s,
        MIN_UPLOAD_RATE,
    )


def create_app(settings: Settings, sandbox: Sandbox, metrics: Metrics, stopping: asyncio.Event) -> ASGIApp:
    """The application with its middleware, ready for a server; stopping tells it that the server is to stop.

    Raises JobTableError, MissingPackagesError, OSError.
    """
    app = FastAPI(
        title="sgmethod",
        version=VERSION,
        description="Encode photographs as 2D Gaussians, and decode them.",
        lifespan=_lifespan,
        servers=[{"url": settings.path_prefix}] if settings.path_prefix else None,
        docs_url=None,  # both pages load scripts from elsewhere, and break the policy of ours
        redoc_url=None,
        redirect_slashes=False,  # it would repeat whatever host the client named
    )
    parts = app.state.parts = Parts(
        settings,
        open_job_table(settings),
        open_storage(settings),
        ClientTasks(settings, sandbox),
        PictureCache(settings.decode_cache_bytes),
        Turns(UPLOADS_IN_MEMORY, settings.max_streams),
        Shares(settings.max_streams, "streams", "streams of events are open"),
        Shares(settings.max_answer_bytes, "answers", "pictures are on their way to clients"),
        stopping,
        KeyRing(settings.key_names),
        metrics,
    )
    metrics.watch(parts.streams)
    metrics.watch(parts.outflow)
    install_problem_handlers(app)
    # The gate does the work; this is how the document says so.
    security = [Security(HTTPBearer(auto_error=False))] if settings.key_names else []
    refusals = problems(401) if settings.key_names else {}
    for routes in (job_routes, event_routes, picture_routes, preview_routes):
        dependencies = [Depends(known_query), Depends(no_stray_body), *security]
        app.include_router(routes.router, dependencies=dependencies, responses=refusals)
    app.include_router(health_routes.router, dependencies=[Depends(known_query)])
    app.mount("/static", PageFiles(directory=STATIC))

    @app.get("/", include_in_schema=False)
    async def page() -> FileResponse:
        """The page on which a person can try the service."""
        return FileResponse(STATIC / "index.html", headers={"Content-Security-Policy": PAGE_POLICY})

    @app.get("/docs", include_in_schema=False)
    async def docs() -> FileResponse:
        """The OpenAPI document, for people."""
        return FileResponse(STATIC / "docs.html", headers={"Content-Security-Policy": PAGE_POLICY})

    return _guarded(app, parts)


def _guarded(app: FastAPI, parts: Parts) -> ASGIApp:
    """The application with its middleware around it."""
    settings = parts.settings
    # From the inside out. They stand outside FastAPI: its answer to an unexpected error skips its own middleware.
    secret = settings.link_secret.get_secret_value()
    gate = Gate(PacedRequests(HeadAsGet(app)), parts.keys, secret)
    uploads = Shares(settings.max_streams, "uploads", "uploads are under way")
    parts.metrics.watch(uploads)
    guarded: ASGIApp = BodyGuard(gate, _body_limits(settings), uploads)
    if settings.cors_origins:
        guarded = CORSMiddleware(
            guarded,
            allow_origins=[origin.strip() for origin in settings.cors_origins.split(",")],
            allow_methods=["GET", "HEAD", "POST", "DELETE"],
            allow_headers=["Authorization", "Idempotency-Key", "Prefer", "Range", "X-Request-Id"],
            expose_headers=["ETag", "Location", "Content-Range", "Preference-Applied", "Retry-After", "X-Request-Id"],
        )
    told = AccessLog(AnswerGuard(ResponseHeaders(RequestMetrics(guarded, parts.metrics)), parts.outflow))
    return WithoutPrefix(told, settings.path_prefix) if settings.path_prefix else told
