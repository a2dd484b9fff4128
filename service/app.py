"""The web application: its parts, its routes, and what stands around them."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version
from pathlib import Path

from anyio import CapacityLimiter
from fastapi import FastAPI
from starlette.responses import FileResponse
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp

from service import job_routes, picture_routes
from service.backends import open_backend, open_storage
from service.decoding import PictureCache, PictureDecoder
from service.middleware import BodyGuard, BodyLimits, ResponseHeaders
from service.parts import Parts
from service.problems import install_problem_handlers
from service.settings import Settings
from service.submission import MULTIPART_OVERHEAD_BYTES
from service.views import HealthView

VERSION = version("sgmethod")
STATIC = Path(__file__).with_name("static")
PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self';"
    " base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
UPLOADS_IN_MEMORY = 4


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    parts: Parts = app.state.parts
    yield
    parts.backend.close()


def _body_limits(settings: Settings) -> BodyLimits:
    return BodyLimits(
        settings.max_upload_bytes + MULTIPART_OVERHEAD_BYTES,
        settings.body_chunk_timeout_s,
        settings.body_timeout_s,
    )


def create_app(settings: Settings) -> ASGIApp:
    """The application with its middleware, ready for a server. Raises BackendError, OSError."""
    app = FastAPI(
        title="sgmethod",
        version=VERSION,
        description="Photographs to small sets of 2D Gaussians and back.",
        lifespan=_lifespan,
        docs_url=None,  # both pages load scripts from elsewhere
        redoc_url=None,
        redirect_slashes=False,  # it would repeat whatever host the client named
    )
    app.state.parts = Parts(
        settings,
        open_backend(settings),
        open_storage(settings),
        PictureDecoder(settings.max_decodes, settings.max_waiting_decodes),
        PictureCache(settings.decode_cache_bytes),
        CapacityLimiter(UPLOADS_IN_MEMORY),
    )
    install_problem_handlers(app)
    app.include_router(job_routes.router)
    app.include_router(picture_routes.router)
    app.mount("/static", StaticFiles(directory=STATIC))

    @app.head("/healthz", include_in_schema=False)
    @app.get("/healthz")
    async def health() -> HealthView:
        """Whether the web process answers; waits for nothing."""
        return HealthView(status="ok", version=VERSION)

    @app.head("/", include_in_schema=False)
    @app.get("/", include_in_schema=False)
    async def page() -> FileResponse:
        """The page on which a person can try the service."""
        return FileResponse(STATIC / "index.html", headers={"Content-Security-Policy": PAGE_POLICY})

    # Outside of FastAPI, whose answer to an unexpected error passes by its own middleware.
    return ResponseHeaders(BodyGuard(app, _body_limits(settings)))
