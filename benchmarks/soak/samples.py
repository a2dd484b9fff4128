"""What there is of a service at a moment, and whether it grew."""

from __future__ import annotations

import contextlib
import sqlite3
import statistics
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.load.service import LoadService, resident_bytes
from service.worker.sweeping import pause_s
from tests.harness.processes import processes

Sample = dict[str, Any]
HELPER = "service.web.helpers.helper"
# Quantities that must not grow, and by how much they may differ by chance: a part, and so much on top.
STEADY = {
    **{"web_mb": (0.1, 5), "worker_mb": (0.1, 5), "supervisor_mb": (0.1, 5), "helpers_mb": (0.1, 20)},
    **{"web_files_open": (0.1, 8), "worker_files_open": (0.1, 4), "web_threads": (0.1, 5), "temporary_files": (0, 6)},
}
LATE_S = 15.0  # that a sweep may take to come, on a busy machine


def sample(service: LoadService, temporary: Path, minutes: float) -> Sample:
    """Processes, rows and files, as they are. minutes: since the start."""
    (web,), (worker,) = service.ours("web"), service.ours("worker")
    helpers = [n for n, p in processes().items() if p.parent == web and HELPER in p.command]
    folder = service.data_dir
    files = {name: {path.name for path in (folder / name).iterdir()} for name in ("sources", "bitstreams")}
    with contextlib.closing(sqlite3.connect(f"file:{folder}/jobs.sqlite3?mode=ro", uri=True)) as db:
        jobs = db.execute("SELECT id, state, finished_at FROM jobs").fetchall()
        trace = db.execute("SELECT count(*) FROM trace").fetchone()[0]
    now = time.time()
    ages = {job: now - finished for job, _, finished in jobs if finished is not None}
    known = {job for job, _, _ in jobs}
    unknown = [name for names in files.values() for name in names if name.partition(".")[0] not in known]
    return {
        "minutes": round(minutes, 2),
        **{"web_mb": _mb(web), "worker_mb": _mb(worker), "supervisor_mb": _mb(service.process.pid)},
        **{"helpers_mb": round(sum(map(_mb, helpers)), 1), "helpers": len(helpers)},
        **{"web_files_open": _open_files(web), "worker_files_open": _open_files(worker), "web_threads": _threads(web)},
        **{"jobs": len(jobs), "trace_points": trace, "waiting": sum(state == "queued" for _, state, _ in jobs)},
        **{"images": len(files["sources"]), "bitstreams": len(files["bitstreams"]), "files_of_no_job": len(unknown)},
        "unfinished_files": sum(1 for _ in (folder / "unfinished").iterdir()),
        "temporary_files": sum(1 for _ in temporary.iterdir()),
        "table_kb": round(sum(path.stat().st_size for path in folder.glob("jobs.sqlite3*")) / 1e3),
        "oldest_job_s": round(max(ages.values(), default=0), 1),
        "oldest_image_s": round(max((ages[job] for job in files["sources"] if job in ages), default=0), 1),
    }


def verdicts(samples: Sequence[Sample], retention_s: float, image_retention_s: float) -> dict[str, bool]:
    """Each claim, and whether the samples under load bear it out. The first third is for caches to fill."""
    third = len(samples) // 3
    middle, last = samples[third : 2 * third], samples[2 * third :]
    pause = pause_s(retention_s, image_retention_s) + LATE_S
    told = {f"{name} does not grow": _steady(name, middle, last) for name in STEADY}
    told["no job stays beyond its time"] = _most("oldest_job_s", samples) <= retention_s + pause
    told["no image stays beyond its time"] = _most("oldest_image_s", samples) <= image_retention_s + pause
    return told


def is_empty(rest: Sample) -> dict[str, bool]:
    """Each claim about what is left when all times are over and nobody asked for more."""
    names = ("jobs", "trace_points", "images", "bitstreams", "unfinished_files", "temporary_files")
    return {f"no {name.replace('_', ' ')} are left at the end": rest[name] == 0 for name in names}


def _steady(name: str, middle: Sequence[Sample], last: Sequence[Sample]) -> bool:
    part, more = STEADY[name]
    return bool(median(name, last) <= (1 + part) * median(name, middle) + more)


def median(name: str, samples: Sequence[Sample]) -> float:
    """Of one quantity."""
    return float(statistics.median(sample[name] for sample in samples))


def _most(name: str, samples: Sequence[Sample]) -> float:
    return float(max(sample[name] for sample in samples))


def _mb(number: int) -> float:
    return round(resident_bytes(number) / 1e6, 1)


def _open_files(number: int) -> int:
    return sum(1 for _ in Path(f"/proc/{number}/fd").iterdir())


def _threads(number: int) -> int:
    return sum(1 for _ in Path(f"/proc/{number}/task").iterdir())
