"""Work of every kind for a long time, and whether memory, files or rows grow.

    python -m benchmarks.soak [--minutes 30] [--retention 300] [--out FILE]

It starts `python -m service serve` with one worker on SQLite, finished jobs kept for `--retention` seconds and their
images for a fifth of that. Clients of every kind (benchmarks.soak.clients) work on it: two encode pictures of 0.05 to
12 megapixels, two look at what came of them, one watches, one does harm. Every so often all processes, rows and files
are counted. Then nobody asks for anything until all times are over, and what is left is counted once more.

It prints a table, and exits with 1 if anything grew or was left.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.load.service import running
from benchmarks.machine import RUNS, Elsewhere, command, origin, write_json
from benchmarks.soak.clients import Client, Encodes, Harms, Looks, Shared, Watches
from benchmarks.soak.samples import LATE_S, is_empty, sample, verdicts
from service.worker.sweeping import pause_s

SAMPLE_S = 15.0
LAST_JOB_S = 300.0
CACHE_BYTES = 16 << 20
CLIENTS: tuple[Callable[[Shared, int], Client], ...] = (Encodes, Encodes, Looks, Looks, Watches, Harms)


def soak(minutes: float, retention_s: float, content: dict[str, Any], out: Path) -> dict[str, Any]:
    """What the JSON holds; written after every sample."""
    elsewhere = Elsewhere()
    image_retention_s = retention_s / 5
    settings = {"workers": 1, "retention_s": retention_s, "source_retention_s": image_retention_s}
    with tempfile.TemporaryDirectory(prefix="sg-soak-") as folder:
        temporary = Path(folder) / "tmp"
        temporary.mkdir()
        environment = {"decode_cache_bytes": CACHE_BYTES, **settings}
        os.environ["TMPDIR"] = str(temporary)  # of the service, which inherits it: nothing of ours goes there
        with running(Path(folder) / "data", **environment) as service:
            shared = Shared(service.url)
            clients = [kind(shared, seed) for seed, kind in enumerate(CLIENTS)]
            for client in clients:
                client.start()
            began, rows = time.monotonic(), []
            while (since_s := time.monotonic() - began) < 60 * minutes:
                rows.append(sample(service, temporary, since_s / 60))
                write_json(out, {**content, "rows": rows})
                print(", ".join(f"{name} {value}" for name, value in rows[-1].items()), file=sys.stderr, flush=True)
                time.sleep(max(0.0, began + len(rows) * SAMPLE_S - time.monotonic()))
            shared.ended.set()
            for client in clients:
                client.join()
            _wait_for_jobs(service)
            time.sleep(retention_s + pause_s(retention_s, image_retention_s) + LATE_S)
            rest = sample(service, temporary, (time.monotonic() - began) / 60)
        log = service.log.read_text()
    trouble = [line for client in clients for line in client.trouble]
    claims = {
        **verdicts(rows, retention_s, image_retention_s),
        **is_empty(rest),
        "no client met an error of the service": not any(word.endswith(" 500") for word in shared.answers),
        "no traceback is in the log": "Traceback" not in log,
        "no client failed": not trouble,
    }
    told = {"answers": dict(sorted(shared.answers.items())), "trouble": trouble, "claims": claims, "at_the_end": rest}
    return {**content, **told, "cores_elsewhere": elsewhere.cores(), "rows": rows}


def _wait_for_jobs(service: Any) -> None:
    deadline = time.monotonic() + LAST_JOB_S
    while time.monotonic() < deadline:
        states = {job["state"] for job in service.client.get("/jobs?limit=200").json()["jobs"]}
        if not states & {"queued", "running"}:
            return
        time.sleep(1)


def main() -> int:
    """Exit status: 0 if every claim holds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0, help="of work (default: 30)")
    parser.add_argument("--retention", type=float, default=300.0, help="seconds for which jobs are kept (default: 300)")
    parser.add_argument("--out", type=Path, default=RUNS / "service" / "soak.json")
    options = parser.parse_args()
    settings = {
        "minutes": options.minutes,
        "retention_s": options.retention,
        "image_retention_s": options.retention / 5,
    }
    head = {"command": command("benchmarks.soak"), **origin(), "remark": "", "settings": settings}
    content = soak(options.minutes, options.retention, head, options.out)
    write_json(options.out, content)
    print("\n".join(f"{'holds ' if holds else 'BROKEN'} {claim}" for claim, holds in content["claims"].items()))
    return 0 if all(content["claims"].values()) else 1


if __name__ == "__main__":
    sys.exit(main())
