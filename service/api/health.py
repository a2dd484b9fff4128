"""Handlers of health checks and metrics, which never wait behind other work."""

from __future__ import annotations

import logging
import math
from contextlib import suppress
from functools import partial
from importlib.metadata import version

from anyio import fail_after, to_thread
from fastapi import Response
from prometheus_client import CONTENT_TYPE_LATEST

from service.api import models
from service.api.context import Context, UseContext
from service.api.problems import ProblemError
from service.errors import JobTableError
from service.jobs.job import Counts

log = logging.getLogger(__name__)

VERSION = version("sgmethod")
STALLED_LEASES = 4  # for which jobs may wait while no worker reports
PATIENCE_S = 2.0  # a table that takes longer counts as unavailable


async def live() -> models.HealthView:
    """Return 200 while the web process runs."""
    return models.HealthView(status="ok", version=VERSION)


async def ready(context: UseContext) -> models.HealthView:
    """Return 200 if jobs are accepted and processed.

    The job table and the storage accept writes, the disk has room, the sandbox does tasks, and workers take jobs.
    """
    return await context.readiness.result(partial(_ready, context))


async def _ready(context: Context) -> models.HealthView:
    counts = await _counts(context)
    if counts is None:
        raise ProblemError(503, "the job table is not responding, or takes no changes", reason="table")
    free_bytes = await _free_bytes(context)
    if free_bytes < context.settings.min_free_bytes:
        raise ProblemError(503, f"the disk is almost full: {free_bytes:,.0f} bytes free", reason="disk")
    if counts.waiting_s is not None:
        stalled_s = counts.waiting_s if counts.silent_s is None else min(counts.waiting_s, counts.silent_s)
        if stalled_s > STALLED_LEASES * context.settings.lease_s:
            detail = f"jobs are waiting, and no worker has reported for {stalled_s:.0f} s"
            raise ProblemError(503, detail, reason="stall")
    if trouble := await context.tasks.trouble(PATIENCE_S):
        log.error("the sandbox is not working: %s", trouble)
        raise ProblemError(503, "the sandbox is not working, so images cannot be read", reason="sandbox")
    return models.HealthView(status="ok", version=VERSION)


async def metrics(context: UseContext) -> Response:
    """Return metrics in Prometheus' text format."""
    counts = await _counts(context)
    with suppress(ProblemError):
        context.metrics.free_bytes.set(await _free_bytes(context))
    context.metrics.cache_bytes.set(context.pictures.bytes)
    context.metrics.waits.set(context.waits.open)
    return Response(context.metrics.text(counts), media_type=CONTENT_TYPE_LATEST)


async def _counts(context: Context) -> Counts | None:
    def ask() -> Counts:
        context.table.check_writable()
        return context.table.counts()

    try:
        with fail_after(PATIENCE_S):
            return await to_thread.run_sync(ask, limiter=context.watching_table, abandon_on_cancel=True)
    except (JobTableError, TimeoutError) as error:
        log.error("the job table is not responding: %r", error)
        return None


async def _free_bytes(context: Context) -> float:
    """Return the free space of the storage. Raises ProblemError 503 if it does not respond."""

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
