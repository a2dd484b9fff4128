"""The service that is measured, and the pictures it is given."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.harness.pictures import saved
from benchmarks.harness.service import ServiceProcess

PATIENCE_S = 300.0


def made_picture(width: int, height: int, seed: int = 0) -> bytes:
    """A PNG of noise at every scale, as photographs have it, and a few edges."""
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
    return saved(Image.fromarray((pixels + 128).clip(0, 255).astype(np.uint8)), compress_level=1)


class LoadService(ServiceProcess):
    """A service under load, whose answers may be long in coming."""

    timeout_s = PATIENCE_S

    def submit(self, image: bytes, bpp: float, time_limit_s: float) -> str:
        """Submit a job; its id."""
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


@contextmanager
def running(data_dir: Path, **settings: Any) -> Iterator[LoadService]:
    """`python -m service serve` until the context ends, which it does in order."""
    service = LoadService(data_dir, **settings)
    try:
        yield service
    finally:
        status = service.stop()
        if status != 0:
            raise SystemExit(f"the service ended with status {status}")
