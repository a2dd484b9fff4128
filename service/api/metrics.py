"""What Prometheus may read: requests as they pass, decodes, and the job table at the moment of asking."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from itertools import accumulate

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, HistogramMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector
from starlette.types import Scope

from service.api.problems import REFUSAL
from service.api.turns import Streams
from service.jobs import endings
from service.jobs.job import Census
from service.process.loops import failures
from service.sandbox.confinement import LAYERS

METHODS = frozenset({"GET", "HEAD", "POST", "DELETE", "PUT", "PATCH", "OPTIONS"})
BUCKETS_S = (0.002, 0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.28, 2.56, 5.12, 10.24, 30.0, 120.0)


class _Totals(Collector):
    """What the job table counts, of all workers and web processes together."""

    def __init__(self) -> None:
        self.so_far: Mapping[str, float] = {}

    def collect(self) -> Iterator[Metric]:
        for ending in endings.ENDINGS:
            words = f"Jobs {ending}, since the job table was made."
            yield CounterMetricFamily(f"sgmethod_jobs_{ending}", words, self.so_far.get(ending, 0.0))
        names = [str(most).replace("inf", "+Inf") for most in endings.BUCKETS_S]
        numbers = accumulate(self.so_far.get(endings.bucket(most), 0.0) for most in endings.BUCKETS_S)
        yield HistogramMetricFamily(
            "sgmethod_encode_seconds",
            "From the claim of a job to its file.",
            buckets=[*zip(names, numbers, strict=True)],
            sum_value=self.so_far.get(endings.SECONDS, 0.0),
        )


class Metrics:
    """The figures of one web process, and of the job table."""

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
        self._streams = Gauge("sgmethod_streams", "Streams of events and waits that are open.", registry=registry)
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
        seen = "Since the last sign of life of a worker, which gives one every 2 s."
        self._workers = Gauge("sgmethod_worker_seen_seconds", seen, ("worker",), registry=registry)
        failed = "Failures of background work that nobody foresaw, since the process started."
        self._failures = Gauge("sgmethod_background_failures", failed, ("process",), registry=registry)
        self._notices = Gauge("sgmethod_webhooks_waiting", "Webhooks to be delivered.", registry=registry)
        waits = "Since the job ended whose webhook has been waiting for longest."
        self._notice_waits = Gauge("sgmethod_oldest_webhook_waits_seconds", waits, registry=registry)
        layer = "Whether a layer of the sandbox holds."
        self._layers = Gauge("sgmethod_sandbox_layer_up", layer, ("layer",), registry=registry)
        self._totals = _Totals()
        registry.register(self._totals)
        self._table = Gauge("sgmethod_job_table_up", "Whether the job table answers.", registry=registry)

    def show_layers(self, absent: Collection[str]) -> None:
        """Show which layers of the sandbox the system does not offer."""
        for layer in LAYERS:
            self._layers.labels(layer).set(layer not in absent)

    def watch(self, streams: Streams) -> None:
        """Show how many are open."""
        self._streams.set_function(lambda: streams.open)

    def note(self, scope: Scope, status: int, seconds: float) -> None:
        """Count a request whose answer begins, by the route that took it."""
        # Labels come from fixed sets: what a client makes up must not fill the memory.
        route = getattr(scope.get("route"), "path", "none")
        method = scope["method"] if scope["method"] in METHODS else "other"
        self.requests.labels(method, route, status).inc()
        self.seconds.labels(route).observe(seconds)
        state = scope["state"]
        if REFUSAL in state:
            self.refusals.labels(state[REFUSAL]).inc()
        if "caller" in state and state["caller"].owner is not None:
            self.key_requests.labels(state["caller"].owner).inc()

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
        self._totals.so_far = census.totals
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
