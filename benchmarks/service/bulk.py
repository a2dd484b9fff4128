"""How long many small pictures take through the service, beside the same encodes in one running Python.

    python -m benchmarks.service bulk [--pictures 200] [--out FILE]

Pictures of 160x120, effort 1. One worker, four pictures at a time as bulk clients send them, then one after the other
with a wait for each. Processor time of all processes stands beside the seconds: other work on the machine changes it
least.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from PIL import Image

import sgmethod
from benchmarks.machine import RUNS, Record
from benchmarks.service.measured import made_picture, png, running
from sgmethod.client import Client, encode_many

SIZE, EFFORT = (160, 120), 1
AT_MOST_S, MORE_AT_MOST_S = 0.5, 0.3  # a picture through the service, and what it takes more than in Python


def timed(pictures: int, encode_all: Callable[[], Any]) -> float:
    """Seconds of each picture."""
    began = time.perf_counter()
    encode_all()
    return round((time.perf_counter() - began) / pictures, 3)


def measure(pictures: int) -> dict[str, Any]:
    """Measure the one row."""
    images = [png(Image.fromarray(made_picture(*SIZE, number))) for number in range(pictures)]
    sgmethod.encode(images[0], effort=EFFORT)
    here_s = timed(pictures, lambda: [sgmethod.encode(image, effort=EFFORT) for image in images])
    before_s = _processor_s()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        items = [(f"{number}.png", image) for number, image in enumerate(images)]
        with running(folder / "data", workers=1) as service, Client(service.url) as client:
            client.encode(images[0], effort=EFFORT)
            bulk_s = timed(pictures, lambda: encode_many(client, items, folder / "out", effort=EFFORT))
            single_s = timed(pictures, lambda: [client.encode(image, effort=EFFORT) for image in images])
    return {
        **{"pictures": pictures, "python_s": here_s, "bulk_s": bulk_s, "one_by_one_s": single_s},
        "service_processor_s": round((_processor_s() - before_s) / (2 * pictures), 3),
        "met": bulk_s <= AT_MOST_S and single_s - here_s <= MORE_AT_MOST_S,
    }


def _processor_s() -> float:
    """Seconds of the processor, of all processes that this one started and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> int:
    """Exit status: 0 if it was fast enough."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=int, default=200)
    parser.add_argument("--out", type=Path, default=RUNS / "service" / "bulk.json")
    options = parser.parse_args()
    settings = {"size": list(SIZE), "effort": EFFORT, "at_most_s": AT_MOST_S, "more_at_most_s": MORE_AT_MOST_S}
    record = Record(options.out, "benchmarks.service bulk", settings)
    if not record.has(pictures=options.pictures):
        record.add(measure(options.pictures))
    return 0 if all(row["met"] for row in record.rows) else 1
