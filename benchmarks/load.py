"""How fast the running service answers while it encodes, and what memory it holds on to.

    python -m benchmarks.load [--images FOLDER] [--out FILE.md]
    python -m benchmarks.load --soak 100 [--soak-minutes 10] [--out FILE.md]

The first starts `python -m service serve`, encodes a picture of 768x512 at 0.25 bpp, and has benchmarks.load_generator
ask for it as PNG 50 times a second, and 20 times a second for /livez, while another encode runs: once with no picture
kept in memory, so that each request decodes, and once with the default. The second encodes pictures of
12 megapixels one after the other and watches the memory of all processes.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from benchmarks.machine import ROOT, in_words, origin
from benchmarks.pictures import pictures_in

SIZE, BPP, ENCODE_S = (768, 512), 0.25, 20.0
RATE, LIVE_RATE = 50.0, 20.0
TARGETS_MS = {"decode p50": 12.0, "decode p99": 40.0, "livez p99": 20.0}
SOAK_SIZE = (4000, 3000)
PATIENCE_S = 300.0


def made_picture(width: int, height: int, seed: int = 0) -> NDArray[np.uint8]:
    """uint8 [height, width, 3]: noise at every scale, as photographs have it, and a few edges."""
    random = np.random.default_rng(seed)
    pixels = np.zeros((height, width, 3))
    cells = 4
    while cells <= max(width, height):
        coarse = random.normal(128, 1, (max(2, cells * height // width), cells, 3)).clip(0, 255)
        layer = [Image.fromarray(coarse[..., c].astype(np.float32)).resize((width, height), 3) for c in range(3)]
        pixels += (np.stack([np.asarray(c) for c in layer], 2) - 128) * 90 / cells**0.8
        cells *= 2
    y, x = np.mgrid[0:height, 0:width]
    for _ in range(6):
        cx, cy, r = random.uniform(0, width), random.uniform(0, height), random.uniform(0.05, 0.2) * width
        pixels[np.hypot(x - cx, y - cy) < r] += random.uniform(-60, 60, 3)
    return (pixels + 128).clip(0, 255).astype(np.uint8)


def picture(folder: Path | None) -> tuple[str, bytes]:
    """Name and PNG of the folder's first picture brought to SIZE, or of one that is made here."""
    if folder is None:
        return "a made picture", png(Image.fromarray(made_picture(*SIZE)))
    pictures = pictures_in(folder)
    if not pictures:
        raise SystemExit(f"there is no picture in {folder}")
    with Image.open(pictures[0]) as image:
        return pictures[0].name, png(ImageOps.fit(image.convert("RGB"), SIZE, Image.Resampling.LANCZOS))


def png(image: Image.Image) -> bytes:
    """The image as a PNG file."""
    file = io.BytesIO()
    image.save(file, "PNG", compress_level=1)
    return file.getvalue()


class Service:
    """A running service."""

    def __init__(self, process: subprocess.Popen[str], url: str) -> None:
        self.process = process
        self.url = url
        self.client = httpx.Client(base_url=url, timeout=PATIENCE_S)

    def submit(self, image: bytes, bpp: float, time_limit_s: float) -> str:
        """The id of the new job."""
        query = {"bpp": bpp, "time_limit_s": time_limit_s}
        answer = self.client.post("/encode", content=image, params=query, headers={"Content-Type": "image/png"})
        answer.raise_for_status()
        return str(answer.json()["id"])

    def wait(self, job_id: str, *states: str) -> dict[str, Any]:
        """The job, once it is in one of the states."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            job: dict[str, Any] = self.client.get(f"/jobs/{job_id}").json()
            if job["state"] in states:
                return job
            if job["state"] == "failed":
                break
            time.sleep(0.1)
        raise SystemExit(f"job {job_id} is {job['state']}: {job['error']}")

    def memory_bytes(self) -> int:
        """Resident memory of supervisor, web process and workers together, without encoders."""
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        return sum(_resident_bytes(number) for number in (str(self.process.pid), *children))


def _resident_bytes(process: str) -> int:
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@contextmanager
def running(data_dir: Path, **settings: object) -> Iterator[Service]:
    """`python -m service serve` until the context ends, which it does in order."""
    chosen = {"SG_PORT": 0, "SG_DATA_DIR": data_dir, **settings}
    environment = {**os.environ, **{name: str(value) for name, value in chosen.items()}}
    command = [sys.executable, "-m", "service", "serve"]
    with (data_dir.parent / "service.log").open("a") as log:
        process = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=log, text=True)
    assert process.stdout is not None
    words = process.stdout.readline().split()
    service = Service(process, words[3].rstrip(",") if len(words) > 3 else "")
    try:
        yield service
    finally:
        service.client.close()
        process.send_signal(signal.SIGTERM)
        status = process.wait(60)
        process.stdout.close()
        if status != 0:
            raise SystemExit(f"the service ended with status {status}")


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


def under_load(service: Service, path: str, seconds: float) -> tuple[Spread, Spread]:
    """Latencies of the path and of /livez while an encode runs."""
    busy = service.submit(png(Image.fromarray(made_picture(1536, 1024, 1))), 1.0, seconds + 60)
    service.wait(busy, "running")
    while not service.client.get(f"/jobs/{busy}").json()["trace"]:
        time.sleep(0.1)
    address = service.url.removeprefix("http://")
    wanted = [f"{RATE}={path}", f"{LIVE_RATE}=/livez"]
    command = [sys.executable, "-m", "benchmarks.load_generator", address, str(seconds), *wanted]
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
        with running(data_dir, SG_DECODE_CACHE_BYTES=0) as service:
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


def measure_memory(encodes: int, minutes: float, time_limit_s: float) -> list[str]:
    """The report on memory, line by line."""
    images = [png(Image.fromarray(made_picture(*SOAK_SIZE, seed))) for seed in range(2)]
    megabytes: list[float] = []
    with tempfile.TemporaryDirectory() as temporary, running(Path(temporary) / "data") as service:
        began = time.monotonic()
        for number in range(encodes):
            job = service.submit(images[number % 2], 0.1, time_limit_s)
            service.wait(job, "done")
            for view in ("?width=800", "?scale=0.5"):
                service.client.get(f"/decode/{job}.png{view}").raise_for_status()
            service.client.delete(f"/jobs/{job}").raise_for_status()
            megabytes.append(service.memory_bytes() / 1e6)
            print(f"{number + 1}: {megabytes[-1]:.0f} MB", file=sys.stderr)
            if time.monotonic() - began > 60 * minutes:
                break
    done = len(megabytes)
    first, last = np.mean(megabytes[: max(1, done // 10)]), np.mean(megabytes[-max(1, done // 10) :])
    return [
        f"{done} encodes of {SOAK_SIZE[0]}x{SOAK_SIZE[1]} ({time_limit_s:g} s of fitting each) with two views of each, "
        f"in {(time.monotonic() - began) / 60:.1f} minutes. Resident memory of supervisor, web process and worker "
        f"between encodes: {megabytes[0]:.0f} MB after the first, {first:.0f} MB in the first tenth, "
        f"{last:.0f} MB in the last, {max(megabytes):.0f} MB at most.",
    ]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.load", description="The service under load.")
    parser.add_argument("--images", type=Path, help="folder whose first picture is asked for (default: a made one)")
    parser.add_argument("--seconds", type=float, default=30.0, help="of load in each case (default: 30)")
    parser.add_argument("--soak", type=int, metavar="N", help="encode N large pictures instead, and watch the memory")
    parser.add_argument("--soak-minutes", type=float, default=10.0, help="but not for longer (default: 10)")
    parser.add_argument("--soak-time-limit", type=float, default=2.0, metavar="S", help="seconds of each encode")
    parser.add_argument("--out", type=Path, help="write the report to this file too")
    options = parser.parse_args()
    load_before = os.getloadavg()[0]
    if options.soak:
        lines = measure_memory(options.soak, options.soak_minutes, options.soak_time_limit)
    else:
        lines = measure_load(options.images, options.seconds)
    report = "\n".join([*lines, "", f"{in_words(origin())}; load before: {load_before:.1f}", ""])
    print(report)
    if options.out is not None:
        options.out.write_text(report)


if __name__ == "__main__":
    main()
