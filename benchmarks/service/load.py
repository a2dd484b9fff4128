"""Measure how fast the service answers while it encodes.

    python -m benchmarks.service load [--seconds 30] [--out FILE]

Starts `python -m service serve` and encodes a picture of 768x512 at 0.25 bpp. While another encode runs, the picture is
requested as PNG 50 or 200 times a second, and /livez 20 times a second: once so that each request is decoded, and
twice so that all but the first are answered from memory.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.machine import RUNS, Record
from benchmarks.service.generator import Request, send_all
from benchmarks.service.uploads import made_picture
from tests.support.processes import wait_until
from tests.support.service import ServiceProcess

SIZE, BPP, ENCODE_S = (768, 512), 0.25, 20.0
LIVE_RATE = 20.0
LIMITS_MS = {"GET /decode/ID.png": {"p50_ms": 12.0, "p99_ms": 40.0}, "GET /livez": {"p99_ms": 20.0}}


@dataclass(frozen=True)
class Case:
    """A load. rate: pictures a second; query: of their address, where {} stands for a number that grows."""

    name: str
    rate: float
    query: str = ""


# A picture stays in memory once it was requested. A slightly shorter prefix of its file counts as another picture.
CASES = (Case("decoded each time", 50, "?prefix=0.99{}"), Case("from memory", 50), Case("from memory, 200", 200))


class LoadService(ServiceProcess):
    """A service under load, whose answers may take long."""

    timeout_s = 300.0

    def submit(self, image: bytes, bpp: float, time_limit_s: float) -> str:
        """Submit a job and return its id."""
        query = {"bpp": bpp, "time_limit_s": time_limit_s}
        answer = self.client.post("/encode", content=image, params=query, headers={"Content-Type": "image/png"})
        return str(answer.raise_for_status().json()["id"])

    def job(self, job_id: str) -> dict[str, Any]:
        """The status of a job."""
        job: dict[str, Any] = self.client.get(f"/jobs/{job_id}").json()
        return job


def under_load(service: LoadService, job: str, case: Case, seconds: float) -> list[dict[str, Any]]:
    """Latencies of the picture and of /livez while an encode runs."""
    busy = service.submit(made_picture(3072, 2048, 1), 1.0, seconds + 60)
    wait_until(lambda: service.job(busy)["trace"], service.timeout_s)
    picture = Request(case.rate, "GET", f"/decode/{job}.png{case.query}")
    series = send_all(service.url, seconds, [picture, Request(LIVE_RATE, "GET", "/livez")])
    if service.job(busy)["state"] != "running":
        raise SystemExit("the encode ended too early: nothing was measured under load")
    service.client.delete(f"/jobs/{busy}")
    return series


def measure(case: Case, image: bytes, seconds: float) -> dict[str, Any]:
    """The row of one case."""
    with tempfile.TemporaryDirectory() as temporary:
        service = LoadService(Path(temporary) / "data")
        try:
            job = service.submit(image, BPP, ENCODE_S)
            result = wait_until(lambda: service.job(job)["result"], service.timeout_s)
            size = len(service.client.get(f"/decode/{job}.png").content)
            series = under_load(service, job, case, seconds)
        finally:
            assert service.stop() == 0
    spreads = dict(zip(LIMITS_MS, series, strict=True))
    met = all(
        found["failed"] == 0 and all(found[name] <= most for name, most in LIMITS_MS[request].items())
        for request, found in spreads.items()
    )
    return {
        **{"case": case.name, "rate": case.rate, "met": met, "spreads": spreads},
        **{"bpp": result["bpp"], "gaussians": result["gaussians"], "png_bytes": size},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0, help="of load in each case (default: 30)")
    parser.add_argument("--out", type=Path, default=RUNS / "service" / "load.json")
    options = parser.parse_args()
    image = made_picture(*SIZE)
    settings = {"picture": "a made picture", "size": list(SIZE), "seconds": options.seconds, "at_most_ms": LIMITS_MS}
    record = Record(options.out, "benchmarks.service load", settings)
    for case in CASES:
        if not record.has(case=case.name):
            record.add(measure(case, image, options.seconds))
