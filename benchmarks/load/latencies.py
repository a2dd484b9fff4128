"""What benchmarks.load.generator measures, in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import numpy as np

from tests.harness.data import ROOT


def spread(series: dict[str, Any]) -> dict[str, Any]:
    """Latencies of one series of requests, from what the generator printed."""
    p50, p99, most = (round(float(ms), 2) for ms in np.percentile(series["ms"], (50, 99, 100)))
    return {"requests": len(series["ms"]), "failed": series["failed"], "p50_ms": p50, "p99_ms": p99, "most_ms": most}


def generated(url: str, seconds: float, *wanted: str, source: str | None = None) -> list[dict[str, Any]]:
    """What the generator measured, for each of the wanted requests."""
    origin = [] if source is None else ["--from", source]
    address = url.removeprefix("http://")
    command = [sys.executable, "-m", "benchmarks.load.generator", address, str(seconds), *origin, *wanted]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    return [spread(series) for series in json.loads(done.stdout)]
