"""How fast the running service answers while it encodes.

    python -m benchmarks.service load [--seconds 30] [--out FILE]

It starts `python -m service serve` and encodes a picture of 768x512 at 0.25 bpp. While another encode takes every core
that it gets, the generator asks for the picture as PNG 50 or 200 times a second, and for /livez 20 times a second: once
with no picture kept in memory, so that each request decodes, and twice with the default, after one request.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.machine import RUNS, Record
from benchmarks.service.generator import Request, send_all
from benchmarks.service.measured import LoadService, made_picture, running

SIZE, BPP, ENCODE_S = (768, 512), 0.25, 20.0
LIVE_RATE = 20.0
AT_MOST_MS = {"GET /decode/ID.png": {"p50_ms": 12.0, "p99_ms": 40.0}, "GET /livez": {"p99_ms": 20.0}}


@dataclass(frozen=True)
class Case:
    """A load. rate: pictures a second; query: of their address, where {} stands for a number that grows."""

    name: str
    rate: float
    query: str = ""


# A picture is in memory once it was asked for; a little less of its file makes another one.
CASES = (Case("decoded each time", 50, "?prefix=0.99{}"), Case("from memory", 50), Case("from memory, 200", 200))


def under_load(service: LoadService, job: str, case: Case, seconds: float) -> list[dict[str, Any]]:
    """Latencies of the picture and of /livez while an encode runs."""
    busy = service.submit(made_picture(3072, 2048, 1), 1.0, seconds + 60)
    service.wait(busy, "running")
    while not service.client.get(f"/jobs/{busy}").json()["trace"]:
        time.sleep(0.1)
    picture = Request(case.rate, "GET", f"/decode/{job}.png{case.query}")
    series = send_all(service.url, seconds, [picture, Request(LIVE_RATE, "GET", "/livez")])
    if service.client.get(f"/jobs/{busy}").json()["state"] != "running":
        raise SystemExit("the encode ended too early: nothing was measured under load")
    service.client.delete(f"/jobs/{busy}")
    return series


def measure(case: Case, image: bytes, seconds: float) -> dict[str, Any]:
    """The row of one case."""
    with tempfile.TemporaryDirectory() as temporary, running(Path(temporary) / "data") as service:
        job = service.submit(image, BPP, ENCODE_S)
        result = service.wait(job, "done")["result"]
        size = len(service.client.get(f"/decode/{job}.png").content)
        series = under_load(service, job, case, seconds)
    spreads = dict(zip(AT_MOST_MS, series, strict=True))
    met = all(
        found["failed"] == 0 and all(found[name] <= most for name, most in AT_MOST_MS[request].items())
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
    settings = {"picture": "a made picture", "size": list(SIZE), "seconds": options.seconds, "at_most_ms": AT_MOST_MS}
    record = Record(options.out, "benchmarks.service load", settings)
    for case in CASES:
        if not record.has(case=case.name):
            record.add(measure(case, image, options.seconds))
