"""What memory the service holds on to: a number of large encodes, or a mixture of work for a number of minutes."""

from __future__ import annotations

import random
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, get_args

from PIL import Image

from benchmarks.load.service import LoadService, made_picture, png, running
from tests.harness.processes import Kind

LARGE = (4000, 3000)
MIXTURE = ((256, 192), (768, 512), (1536, 1024), (2048, 1536))
BPP = 0.1
VIEWS = (".png?width=800", ".webp?scale=0.5", ".jpg?width=320")
SAMPLE_S = 0.2
REST_S = 5.0
TOLERANCE = 1.2  # of what was there after the first encode; allocators keep some
# Kept pictures are memory that is meant to be held; without them the floor is one.
SETTINGS: dict[str, Any] = {"workers": 1, "decode_cache_bytes": 0, "retention_s": 0}
NAMES: dict[Kind, str] = {"web": "web process", "worker": "worker", "encoder": "encoder"}


class Watch:
    """Samples the memory of a service's processes all the time. most: megabytes of each kind."""

    def __init__(self, service: LoadService) -> None:
        self._service = service
        self._ended = threading.Event()
        self.most = dict.fromkeys(NAMES, 0.0)

    def sample(self) -> dict[Kind, float]:
        """Megabytes of each kind at this moment."""
        now: dict[Kind, float] = {kind: self._service.memory_mb(kind) for kind in get_args(Kind)}
        self.most = {kind: max(self.most[kind], megabytes) for kind, megabytes in now.items()}
        return now

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Sample until the context ends."""

        def go_on() -> None:
            while not self._ended.wait(SAMPLE_S):
                self.sample()

        thread = threading.Thread(target=go_on)
        thread.start()
        try:
            yield
        finally:
            self._ended.set()
            thread.join()


def _use(service: LoadService, image: bytes, time_limit_s: float) -> None:
    """Encode the picture, look at it from all sides, remove it."""
    job = service.submit(image, BPP, time_limit_s)
    service.wait(job, "done")
    for view in VIEWS:
        service.client.get(f"/decode/{job}{view}").raise_for_status()
    bitstream = service.client.get(f"/bitstreams/{job}.sg").raise_for_status().content
    service.client.post("/decode?width=640", content=bitstream).raise_for_status()
    service.client.delete(f"/jobs/{job}").raise_for_status()


def _measure(images: list[bytes], encodes: int, minutes: float, time_limit_s: float) -> tuple[int, float, list[str]]:
    """How many encodes were done in how many minutes, and the table: of so many encodes, or so many minutes."""
    chance = random.Random(1)
    with tempfile.TemporaryDirectory() as temporary, running(Path(temporary) / "data", **SETTINGS) as service:
        watch = Watch(service)
        service.client.get("/readyz").raise_for_status()
        start = watch.sample()
        _use(service, images[0], time_limit_s)
        floor = watch.sample()
        began, done = time.monotonic(), 1
        with watch.watching():
            while done < encodes and time.monotonic() - began < 60 * minutes:
                _use(service, chance.choice(images), time_limit_s)
                done += 1
                now = watch.sample()
                print(f"{done}: web {now['web']:.0f} MB, worker {now['worker']:.0f} MB", file=sys.stderr, flush=True)
            took_s = time.monotonic() - began
        time.sleep(REST_S)
        after = watch.sample()
    lines = [
        "| process | at the start MB | after the first encode MB | most MB | afterwards MB |",
        "|---|---|---|---|---|",
    ]
    for kind, name in NAMES.items():
        figures = (start[kind], floor[kind], watch.most[kind], after[kind])
        lines.append(f"| {name} | {' | '.join(f'{megabytes:.0f}' for megabytes in figures)} |")
    lines.append("")
    for kind in ("web", "worker"):
        met = after[kind] <= TOLERANCE * floor[kind]
        lines.append(
            f"- {NAMES[kind]}: {after[kind] / floor[kind]:.2f} times its memory after the first encode, at most "
            f"{TOLERANCE:g}: {'met' if met else 'missed'}"
        )
    return done, took_s / 60, lines


def measure_encodes(encodes: int, time_limit_s: float) -> list[str]:
    """The report on so many encodes of 12 megapixels, line by line."""
    images = [png(Image.fromarray(made_picture(*LARGE, seed))) for seed in range(2)]
    done, minutes, lines = _measure(images, encodes, float("inf"), time_limit_s)
    return [
        f"{done} encodes of {LARGE[0]}x{LARGE[1]}, time limit {time_limit_s:g} s, with {len(VIEWS) + 1} pictures "
        f"decoded after each, in {minutes:.1f} minutes. Resident memory; pictures are not kept in memory.",
        "",
        *lines,
    ]


def measure_soak(minutes: float, time_limit_s: float) -> list[str]:
    """The report on a mixture of pictures for so many minutes, line by line."""
    sizes = ", ".join(f"{w}x{h}" for w, h in MIXTURE)
    images = [png(Image.fromarray(made_picture(*size, seed))) for seed, size in enumerate(MIXTURE)]
    done, took, lines = _measure(images, sys.maxsize, minutes, time_limit_s)
    return [
        f"{done} encodes of {sizes} at random, time limit {time_limit_s:g} s, "
        f"with {len(VIEWS) + 1} pictures decoded after each, in {took:.1f} minutes. Resident memory; pictures are not "
        "kept in memory.",
        "",
        *lines,
    ]
