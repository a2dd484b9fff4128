"""What Prometheus may read: requests as they pass, decodes, and the job table at the moment of asking."""

from __future__ import annotations

import time
from collections.abc import Collection

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, generate_latest
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.jobs.table import Census
from service.process.background import failures
from service.sandbox.confinement import LAYERS
from service.web.guards.problems import REFUSAL
from service.web.guards.shares import Shares

METHODS = frozenset({"GET", "HEAD", "POST", "DELETE", "PUT", "PATCH", "OPTIONS"})
BUCKETS_S = (0.002, 0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.28, 2.56, 5.12, 10.24, 30.0, 120.0)


class Metrics:
    """The figures of one web process."""

    def __init__(self) -> None:
        self._registry = registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        names = ("method", "route", "status")
        self.requests = Counter("sgmethod_requests", "Requests answered.", names, registry=registry)
        self.seconds = Histogram(
            "sgmethod_request_seconds",
            "From the head of a request to the head of its answer.",
            ("route",),
            buckets=BUCKETS_S,
            registry=registry,
        )
        self.refusals = Counter("sgmethod_refusals", "Requests refused.", ("reason",), registry=registry)
        self._taken = Gauge(
            "sgmethod_taken", "What clients have now of things that are limited.", ("what",), registry=registry
        )
        self.accepted = Counter("sgmethod_jobs_accepted", "Jobs accepted.", registry=registry)
        self.key_requests = Counter("sgmethod_key_requests", "Requests of an API key.", ("key",), registry=registry)
        self.key_jobs = Counter("sgmethod_key_jobs", "Jobs accepted of an API key.", ("key",), registry=registry)
        self.decode_seconds = Histogram(
            "sgmethod_decode_seconds",
            "Drawing a picture, with the wait for a thread.",
            buckets=BUCKETS_S,
            registry=registry,
        )
        self.cache = Counter("sgmethod_decode_cache", "Pictures looked for in memory.", ("found",), registry=registry)
        self.cache_bytes = Gauge("sgmethod_decode_cache_bytes", "Bytes of pictures in memory.", registry=registry)
        self.free_bytes = Gauge("sgmethod_free_bytes", "Room that is left in the data folder.", registry=registry)
        self._stored = Gauge("sgmethod_stored_bytes", "Bytes of images and bitstreams.", registry=registry)
        self._jobs = Gauge("sgmethod_jobs", "Jobs in the table.", ("state",), registry=registry)
        self._waiting = Gauge("sgmethod_oldest_job_waits_seconds", "Age of the oldest queued job.", registry=registry)
        self._silence = Gauge("sgmethod_workers_silent_seconds", "Since any worker was heard from.", registry=registry)
        seen = "Since the last sign of life of a worker, which gives one every 5 s."
        self._workers = Gauge("sgmethod_worker_seen_seconds", seen, ("worker",), registry=registry)
        failed = "Failures of background work that nobody foresaw, since the process started."
        self._failures = Gauge("sgmethod_background_failures", failed, ("process",), registry=registry)
        self._notices = Gauge("sgmethod_webhooks_waiting", "Webhooks to be delivered.", registry=registry)
        waits = "Since the job ended whose webhook has been waiting for longest."
        self._notice_waits = Gauge("sgmethod_oldest_webhook_waits_seconds", waits, registry=registry)
        layer = "Whether a layer of the sandbox holds."
        self._layers = Gauge("sgmethod_sandbox_layer_up", layer, ("layer",), registry=registry)
        self._table = Gauge("sgmethod_job_table_up", "Whether the job table answers.", registry=registry)

    def show_layers(self, absent: Collection[str]) -> None:
        """Show which layers of the sandbox the system does not offer."""
        for layer in LAYERS:
            self._layers.labels(layer).set(layer not in absent)

    def watch(self, shares: Shares) -> None:
        """Show how much of a limited thing clients have."""
        self._taken.labels(shares.reason).set_function(shares.total)

    def accept(self, owner: str | None) -> None:
        """Count a job that was accepted, and whose API key it came with."""
        self.accepted.inc()
        if owner is not None:
            self.key_jobs.labels(owner).inc()

    def observe(self, census: Census | None) -> None:
        """Take over the job table's figures; None if it does not answer."""
        self._table.set(census is not None)
        self._failures.clear()
        for process, count in {"web": failures.total(), **(census.failures if census else {})}.items():
            self._failures.labels(process).set(count)
        if census is None:
            return
        self._workers.clear()
        for worker, seconds in census.workers.items():
            self._workers.labels(worker).set(max(0.0, seconds))
        for state, count in census.jobs.items():
            self._jobs.labels(state).set(count)
        self._stored.set(census.stored_bytes)
        self._waiting.set(census.waiting_s or 0.0)
        self._notices.set(census.notices)
        self._notice_waits.set(max(0.0, census.notice_waits_s))
        self._silence.set(max(0.0, census.silent_s or 0.0))

    def text(self) -> bytes:
        """Everything, in Prometheus's text format."""
        return generate_latest(self._registry)


class RequestMetrics:
    """Middleware: counts and times requests, by the route that took them."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        started = time.perf_counter()

        async def note(message: Message) -> None:
            if message["type"] == "http.response.start":
                # Labels come from fixed sets: what a client makes up must not fill the memory.
                route = getattr(scope.get("route"), "path", "none")
                method = scope["method"] if scope["method"] in METHODS else "other"
                self._metrics.requests.labels(method, route, message["status"]).inc()
                self._metrics.seconds.labels(route).observe(time.perf_counter() - started)
                state = scope.get("state", {})
                if REFUSAL in state:
                    self._metrics.refusals.labels(state[REFUSAL]).inc()
                if "caller" in state and state["caller"].owner is not None:
                    self._metrics.key_requests.labels(state["caller"].owner).inc()
            await send(message)

        await self._app(scope, receive, note)
