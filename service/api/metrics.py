"""Prometheus metrics: of requests and decodes as they happen, and of the job table when asked."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from importlib.metadata import version

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, Info, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, SummaryMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector
from starlette.types import Scope

from service.api.problems import NAMED_REASONS, REASONS, REFUSAL
from service.jobs import tallies
from service.jobs.job import Counts
from service.sandbox.confinement import LAYERS

VERSION = version("sgmethod")
METHODS = frozenset({"GET", "HEAD", "POST", "DELETE", "PUT", "PATCH", "OPTIONS"})
WAITED_S = "waited_s"  # the attribute of request.state: seconds of waiting that the client asked for
BUCKETS_S = (0.002, 0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.28, 2.56, 5.12, 10.24, 30.0, 120.0)


def _gauges(name: str, words: str, label: str, values: Iterable[tuple[str, float]]) -> Metric:
    """Return one gauge with a value for each label."""
    family = GaugeMetricFamily(name, words, labels=[label])
    for which, value in values:
        family.add_metric([which], value)
    return family


class _TableFigures(Collector):
    """Metrics from the job table, over all workers and web processes. counts: None if it does not respond."""

    def __init__(self) -> None:
        self.counts: Counts | None = None

    def collect(self) -> Iterator[Metric]:
        counts = self.counts
        yield GaugeMetricFamily("sgmethod_job_table_up", "Whether the job table answers.", counts is not None)
        if counts is None:
            return
        yield _gauges("sgmethod_jobs", "Jobs in the table.", "state", counts.jobs.items())
        seen = "Since the last report of a worker, which reports every 2 s."
        since = {worker: max(0.0, seconds) for worker, seconds in counts.workers.items()}
        yield _gauges("sgmethod_worker_seen_seconds", seen, "worker", since.items())
        silent = "Since any worker was heard from; +Inf if none is there."
        for name, words, value in (
            ("stored_bytes", "Bytes of images and bitstreams.", counts.stored_bytes),
            (
                "oldest_job_waits_seconds",
                "How long the oldest queued job has waited for a worker.",
                max(0.0, counts.waiting_s or 0.0),
            ),
            ("workers_silent_seconds", silent, math.inf if counts.silent_s is None else max(0.0, counts.silent_s)),
        ):
            yield GaugeMetricFamily(f"sgmethod_{name}", words, value)
        yield from _totals(counts.totals)


def _totals(so_far: Mapping[str, float]) -> Iterator[Metric]:
    for outcome in tallies.OUTCOMES:
        words = f"Jobs {outcome.replace('_', ' ')}, since the job table was made."
        yield CounterMetricFamily(f"sgmethod_jobs_{outcome}", words, so_far.get(outcome, 0.0))
    for name, words in (
        (tallies.ENCODING, "From the claim of a job to its file."),
        (tallies.QUEUEING, "From the acceptance of a job to its last claim, of jobs that ended."),
    ):
        number, seconds = int(so_far.get(f"{name}_count", 0)), so_far.get(f"{name}_sum", 0.0)
        yield SummaryMetricFamily(f"sgmethod_{name}", words, number, seconds)


class Metrics:
    """Metrics of this web process and of the job table. absent: layers of the sandbox that the system lacks."""

    def __init__(self, absent: Collection[str] = ()) -> None:
        self._registry = registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        Info("sgmethod_build", "The version that runs.", registry=registry).info({"version": VERSION})
        names = ("method", "route", "status")
        self.requests = Counter("sgmethod_requests", "Requests answered.", names, registry=registry)
        self.seconds = Histogram(
            "sgmethod_request_seconds",
            "From the head of a request to the head of its answer, without the wait for a job that it asked for.",
            ("route",),
            buckets=BUCKETS_S,
            registry=registry,
        )
        self.refusals = Counter("sgmethod_refusals", "Requests refused.", ("reason",), registry=registry)
        for reason in (*REASONS.values(), *NAMED_REASONS):
            self.refusals.labels(reason)  # increase() does not see the value that a series begins with
        self.waits = Gauge("sgmethod_waits", "Requests that wait for a job.", registry=registry)
        self.decode_seconds = Histogram(
            "sgmethod_decode_seconds",
            "Drawing a picture, with the wait for its turn.",
            buckets=BUCKETS_S,
            registry=registry,
        )
        self.free_bytes = Gauge("sgmethod_free_bytes", "Free bytes of the storage.", registry=registry)
        layer = "Whether a layer of the sandbox holds."
        layers = Gauge("sgmethod_sandbox_layer_up", layer, ("layer",), registry=registry)
        for name in LAYERS:
            layers.labels(name).set(name not in absent)
        self._table = _TableFigures()
        registry.register(self._table)

    def note(self, scope: Scope, status: int, seconds: float) -> None:
        """Count a request when its response begins, by its route."""
        # Labels come from fixed sets, so that clients cannot create metrics without limit.
        route = getattr(scope.get("route"), "path", "none")
        method = scope["method"] if scope["method"] in METHODS else "other"
        self.requests.labels(method, route, status).inc()
        state = scope["state"]
        self.seconds.labels(route).observe(seconds - state.get(WAITED_S, 0.0))
        if REFUSAL in state:
            self.refusals.labels(state[REFUSAL]).inc()

    def text(self, counts: Counts | None) -> bytes:
        """Return all metrics in Prometheus' text format. counts: of the job table; None if it does not respond."""
        self._table.counts = counts
        return generate_latest(self._registry)
