"""Whether the service lives, is ready and is busy: answers that never wait behind work."""

from __future__ import annotations

import logging
import math
from contextlib import suppress
from importlib.metadata import version

from anyio import fail_after, to_thread
from fastapi import Response
from prometheus_client import CONTENT_TYPE_LATEST

from service.api import models
from service.api.context import Context, UseContext
from service.api.problems import ProblemError
from service.errors import JobTableError
from service.jobs.job import Census

log = logging.getLogger(__name__)

VERSION = version("sgmethod")
STALLED_LEASES = 4  # for which jobs may wait without a sign of life from any worker
PATIENCE_S = 2.0  # a table that takes longer is no better than none


async def live() -> models.HealthView:
    """200 as long as the web process answers."""
    return models.HealthView(status="ok", version=VERSION)


async def ready(context: UseContext) -> models.HealthView:
    """200 if jobs are accepted and processed: the job table and storage respond, the sandbox does tasks, and workers
    take jobs.
    """
    census = await _census(context)
    if census is None:
        raise ProblemError(503, "the job table is not responding, or takes no changes", reason="table")
    free_bytes = await _free_bytes(context)
    if free_bytes < context.settings.min_free_bytes:
        raise ProblemError(503, f"the disk is almost full: {free_bytes:,.0f} bytes free", reason="disk")
    if census.waiting_s is not None:
        stalled_s = census.waiting_s if census.silent_s is None else min(census.waiting_s, census.silent_s)
        if stalled_s > STALLED_LEASES * context.settings.lease_s:
            detail = f"jobs are waiting, and no worker has reported for {stalled_s:.0f} s"
            raise ProblemError(503, detail, reason="stall")
    if trouble := await context.tasks.trouble(PATIENCE_S):
        log.error("the sandbox does no tasks: %s", trouble)
        raise ProblemError(503, "the sandbox does no tasks, without which no image is read", reason="sandbox")
    return models.HealthView(status="ok", version=VERSION)


async def metrics(context: UseContext) -> Response:
    """Metrics in Prometheus' text format."""
    census = await _census(context)
    with suppress(ProblemError):
        context.metrics.free_bytes.set(await _free_bytes(context))
    context.metrics.cache_bytes.set(context.pictures.bytes)
    context.metrics.streams.set(context.streams.open)
    return Response(context.metrics.text(census), media_type=CONTENT_TYPE_LATEST)


async def _census(context: Context) -> Census | None:
    def ask() -> Census:
        context.table.check_writable()
        return context.table.census()

    try:
        with fail_after(PATIENCE_S):
            return await to_thread.run_sync(ask, limiter=context.watching_table, abandon_on_cancel=True)
    except (JobTableError, TimeoutError) as error:
        log.error("the job table is not responding: %r", error)
        return None


async def _free_bytes(context: Context) -> float:
    """Bytes that still fit into the storage. Raises ProblemError 503 if it does not answer."""

    def ask() -> int | None:
        context.storage.check()
        return context.storage.free_bytes()

    try:
        with fail_after(PATIENCE_S):
            free_bytes = await to_thread.run_sync(ask, limiter=context.watching_storage, abandon_on_cancel=True)
    except (OSError, TimeoutError) as error:
        log.error("the storage is not responding: %r", error)
        raise ProblemError(503, "the storage is not responding", reason="storage") from error
    return math.inf if free_bytes is None else free_bytes
