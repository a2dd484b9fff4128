"""Handlers of health checks and metrics, which never wait behind other work."""

from __future__ import annotations

import logging

from fastapi import Response
from prometheus_client import CONTENT_TYPE_LATEST

from service.api.context import UseContext
from service.api.metrics import VERSION
from service.api.probes import TIMEOUT_S
from service.api.problems import ProblemError

log = logging.getLogger(__name__)

OK = {"status": "ok", "version": VERSION}
STALLED_LEASES = 4  # for which jobs may wait while no worker reports


async def live() -> dict[str, str]:
    """Return 200 while the web process runs."""
    return OK


async def ready(context: UseContext) -> dict[str, str]:
    """Return 200 if jobs are accepted and processed.

    The job table and the storage accept writes, the disk has room, the sandbox does tasks, and workers take jobs.
    """
    parts = await context.probes.parts()
    counts, free_bytes = parts.counts, parts.free_bytes
    if counts is None:
        raise ProblemError(503, "the job table is not responding, or takes no changes", reason="table")
    if free_bytes is None:
        raise ProblemError(503, "the storage is not responding", reason="storage")
    if free_bytes < context.settings.min_free_bytes:
        raise ProblemError(503, f"the disk is almost full: {free_bytes:,.0f} bytes free", reason="disk")
    if counts.waiting_s is not None:
        stalled_s = counts.waiting_s if counts.silent_s is None else min(counts.waiting_s, counts.silent_s)
        if stalled_s > STALLED_LEASES * context.settings.lease_s:
            detail = f"jobs are waiting, and no worker has reported for {stalled_s:.0f} s"
            raise ProblemError(503, detail, reason="stall")
    if trouble := await context.tasks.trouble(TIMEOUT_S):
        log.error("the sandbox is not working: %s", trouble)
        raise ProblemError(503, "the sandbox is not working, so images cannot be read", reason="sandbox")
    return OK


async def metrics(context: UseContext) -> Response:
    """Return metrics in Prometheus' text format."""
    parts = await context.probes.parts()
    if parts.free_bytes is not None:
        context.metrics.free_bytes.set(parts.free_bytes)
    context.metrics.waits.set(context.waits.total)
    return Response(context.metrics.text(parts.counts), media_type=CONTENT_TYPE_LATEST)
