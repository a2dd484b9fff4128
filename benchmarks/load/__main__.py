"""How fast the running service answers while it encodes, and what memory it holds on to.

    python -m benchmarks.load [--images FOLDER] [--out FILE.md]
    python -m benchmarks.load --encodes 100 [--time-limit 4] [--out FILE.md]
    python -m benchmarks.load --soak MINUTES [--time-limit 4] [--out FILE.md]

The first command starts `python -m service serve` and encodes a picture of 768x512 at 0.25 bpp. While another encode
runs, benchmarks.load.generator asks for the picture as PNG 50 times a second, and for /livez 20 times a second. It does
so twice: with no picture kept in memory, so that each request decodes, and with the default.

The other two encode pictures one after the other and watch the memory of web process, worker and encoder process.
--encodes takes that many pictures of 12 megapixels, --soak pictures of several sizes for that long.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageOps

from benchmarks.load.memory import measure_encodes, measure_soak
from benchmarks.load.service import LoadService, made_picture, png, running
from benchmarks.machine import in_words, origin
from benchmarks.pictures import pictures_in
from tests.harness.data import ROOT

SIZE, BPP, ENCODE_S = (768, 512), 0.25, 20.0
RATE, LIVE_RATE = 50.0, 20.0
TARGETS_MS = {"decode p50": 12.0, "decode p99": 40.0, "livez p99": 20.0}


def picture(folder: Path | None) -> tuple[str, bytes]:
    """Name and PNG of the folder's first picture brought to SIZE, or of one that is made here."""
    if folder is None:
        return "a made picture", png(Image.fromarray(made_picture(*SIZE)))
    pictures = pictures_in(folder)
    if not pictures:
        raise SystemExit(f"there is no picture in {folder}")
    with Image.open(pictures[0]) as image:
        return pictures[0].name, png(ImageOps.fit(image.convert("RGB"), SIZE, Image.Resampling.LANCZOS))


@dataclass(frozen=True)
class Spread:
    """Latencies of one series of requests, in milliseconds."""

    count: int
    failed: int
    p50: float
    p99: float
    most: float

    @classmethod
    def of(cls, series: dict[str, Any]) -> Spread:
        """From what the generator printed."""
        p50, p99, most = np.percentile(series["ms"], (50, 99, 100))
        return cls(len(series["ms"]), series["failed"], float(p50), float(p99), float(most))

    def row(self, *names: str) -> str:
        """A row of the table."""
        figures = f"{self.count} | {self.failed} | {self.p50:.1f} | {self.p99:.1f} | {self.most:.1f}"
        return f"| {' | '.join(names)} | {figures} |"


def under_load(service: LoadService, path: str, seconds: float) -> tuple[Spread, Spread]:
    """Latencies of the path and of /livez while an encode runs."""
    busy = service.submit(png(Image.fromarray(made_picture(1536, 1024, 1))), 1.0, seconds + 60)
    service.wait(busy, "running")
    while not service.client.get(f"/jobs/{busy}").json()["trace"]:
        time.sleep(0.1)
    address = service.url.removeprefix("http://")
    wanted = [f"{RATE}={path}", f"{LIVE_RATE}=/livez"]
    command = [sys.executable, "-m", "benchmarks.load.generator", address, str(seconds), *wanted]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    if service.client.get(f"/jobs/{busy}").json()["state"] != "running":
        raise SystemExit("the encode ended too early: nothing was measured under load")
    service.client.delete(f"/jobs/{busy}")
    decode, live = (Spread.of(series) for series in json.loads(done.stdout))
    return decode, live


def measure_load(folder: Path | None, seconds: float) -> list[str]:
    """The report on requests under load, line by line."""
    name, image = picture(folder)
    rows: dict[str, tuple[Spread, Spread]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        data_dir = Path(temporary) / "data"
        with running(data_dir, decode_cache_bytes=0) as service:
            job = service.submit(image, BPP, ENCODE_S)
            result = service.wait(job, "done")["result"]
            path = f"/decode/{job}.png"
            size = len(service.client.get(path).content)
            rows["decoded each time"] = under_load(service, path, seconds)
        with running(data_dir) as service:
            service.client.get(path)
            rows["from memory"] = under_load(service, path, seconds)
    lines = [
        f"PNG of {name}, {SIZE[0]}x{SIZE[1]} at {result['bpp']:.3f} bpp ({result['gaussians']} Gaussians, PNG of "
        f"{size:,} bytes), {RATE:g} requests a second for {seconds:g} s, beside {LIVE_RATE:g} of /livez and one encode "
        "of 1536x1024 that takes every core it gets.",
        "",
        "| picture | request | requests | failed | p50 ms | p99 ms | longest ms |",
        "|---|---|---|---|---|---|---|",
    ]
    verdicts = []
    for case, (decode, live) in rows.items():
        lines += [decode.row(case, "GET /decode/ID.png"), live.row(case, "GET /livez")]
        reached = dict(zip(TARGETS_MS, (decode.p50, decode.p99, live.p99), strict=True))
        verdicts += [
            f"- {case}: {what} {reached[what]:.1f} ms, at most {most:g} ms: "
            f"{'met' if reached[what] <= most and not decode.failed + live.failed else 'missed'}"
            for what, most in TARGETS_MS.items()
        ]
    return [*lines, "", *verdicts]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.load", description="The service under load.")
    parser.add_argument("--images", type=Path, help="folder whose first picture is asked for (default: a made one)")
    parser.add_argument("--seconds", type=float, default=30.0, help="of load in each case (default: 30)")
    memory = parser.add_mutually_exclusive_group()
    memory.add_argument("--encodes", type=int, metavar="N", help="encode N pictures of 12 megapixels instead")
    memory.add_argument(
        "--soak", type=float, metavar="MINUTES", help="encode pictures of several sizes for so long instead"
    )
    parser.add_argument("--time-limit", type=float, default=4.0, metavar="S", help="of each of those (default: 4)")
    parser.add_argument("--out", type=Path, help="write the report to this file too")
    options = parser.parse_args()
    load_before = os.getloadavg()[0]
    if options.encodes:
        lines = measure_encodes(options.encodes, options.time_limit)
    elif options.soak:
        lines = measure_soak(options.soak, options.time_limit)
    else:
        lines = measure_load(options.images, options.seconds)
    report = "\n".join([*lines, "", f"{in_words(origin())}; load before: {load_before:.1f}", ""])
    print(report)
    if options.out is not None:
        options.out.write_text(report)


if __name__ == "__main__":
    main()
