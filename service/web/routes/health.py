"""Whether the service lives, is ready and is busy: answers that never wait behind work."""

from __future__ import annotations

import logging
import math
from contextlib import suppress
from importlib.metadata import version

from anyio import fail_after, to_thread
from fastapi import APIRouter, Response
from prometheus_client import CONTENT_TYPE_LATEST

from service.jobs.table import Census, JobTableError
from service.web.guards.problems import ProblemError, problems
from service.web.routes import answers
from service.web.routes.answers import curl
from service.web.routes.parts import Parts, UseCaller, UseParts

log = logging.getLogger(__name__)
router = APIRouter()

VERSION = version("sgmethod")
PATIENCE_S = 2.0  # a table that takes longer is no better than none


@router.get("/healthz", include_in_schema=False)  # the name before there was /readyz
@router.get("/livez", summary="Liveness", openapi_extra=curl("HOST/livez"))
async def live() -> answers.HealthView:
    """200 as long as the web process answers."""
    return answers.HealthView(status="ok", version=VERSION)


@router.get("/readyz", responses=problems(503), summary="Readiness", openapi_extra=curl("HOST/readyz"))
async def ready(parts: UseParts) -> answers.HealthView:
    """200 if jobs are accepted and processed: the job table and storage respond, and workers take jobs."""
    census = await _census(parts)
    if census is None:
        raise ProblemError(503, "the job table is not responding", reason="table")
    free_bytes = await _free_bytes(parts)
    if free_bytes < parts.settings.min_free_bytes:
        raise ProblemError(503, f"the disk is almost full: {free_bytes:,.0f} bytes free", reason="disk")
    if census.waiting_s is not None:
        stalled_s = census.waiting_s if census.silent_s is None else min(census.waiting_s, census.silent_s)
        if stalled_s > parts.settings.stall_s:
            detail = f"jobs are waiting, and no worker has reported for {stalled_s:.0f} s"
            raise ProblemError(503, detail, reason="stall")
    return answers.HealthView(status="ok", version=VERSION)


@router.get(
    "/metrics",
    response_class=Response,
    responses={200: {"content": {"text/plain": {}}}, **problems(403)},
    summary="Prometheus metrics",
    openapi_extra=curl("HOST/metrics"),
)
async def metrics(parts: UseParts, caller: UseCaller) -> Response:
    """Metrics in Prometheus' text format."""
    reader = parts.settings.metrics_key
    if reader and caller.owner != reader:
        raise ProblemError(403, "this API key may not read metrics")
    parts.metrics.observe(await _census(parts))
    with suppress(ProblemError):
        parts.metrics.free_bytes.set(await _free_bytes(parts))
    parts.metrics.cache_bytes.set(parts.pictures.bytes)
    return Response(parts.metrics.text(), media_type=CONTENT_TYPE_LATEST)


async def _census(parts: Parts) -> Census | None:
    try:
        with fail_after(PATIENCE_S):
            return await to_thread.run_sync(parts.table.census, limiter=parts.watching, abandon_on_cancel=True)
    except (JobTableError, TimeoutError) as error:
        log.error("the job table is not responding: %r", error)
        return None


async def _free_bytes(parts: Parts) -> float:
    """Room that is left in the storage. Raises ProblemError 503 if it does not answer."""
    try:
        with fail_after(PATIENCE_S):
            return await to_thread.run_sync(_room, parts, limiter=parts.watching, abandon_on_cancel=True)
    except (OSError, TimeoutError) as error:
        log.error("the storage is not responding: %r", error)
        raise ProblemError(503, "the storage is not responding", reason="storage") from error


def _room(parts: Parts) -> float:
    parts.storage.check()
    free_bytes = parts.storage.free_bytes()
    return math.inf if free_bytes is None else free_bytes
