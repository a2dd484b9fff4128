"""What a result must say of its origin: the machine, the commit, the date."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from sgmethod.io.files import write_atomically
from sgmethod.native import native
from tests.harness.data import ROOT

ISA_NAMES = ("x86-64", "AVX2", "AVX-512")
RESULTS = ROOT / "benchmarks" / "results"
PACKAGES = ("numpy", "torch", "imagecodecs")


def origin() -> dict[str, object]:
    """Plain JSON types: commit, date (UTC) and machine."""
    return {
        "commit": commit(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {
            "processor": _processor(),
            "cores": len(os.sched_getaffinity(0)),
            "instruction_set": ISA_NAMES[native.best_isa()],
            "system": f"{platform.system()} {platform.release()} {platform.machine()}",
            "python": platform.python_version(),
            "packages": {name: _version(name) for name in PACKAGES},
        },
    }


def in_words(where: dict[str, object]) -> str:
    """One line for the foot of a table, from what origin() gave."""
    machine = where["machine"]
    assert isinstance(machine, dict)
    cores, isa = machine["cores"], machine["instruction_set"]
    return f"{machine['processor']}, {cores} cores, {isa}; commit {where['commit']}; {where['date']}"


def commit() -> str:
    """The commit checked out; if tracked files differ from it, with a name for the difference."""
    head = _git("rev-parse", "--short=12", "HEAD").strip()
    if not head:
        return "unknown"
    difference = _git("diff", "HEAD", "--", "sgmethod", "service", "benchmarks", ":!benchmarks/results")
    if not difference:
        return head
    return f"{head}+{hashlib.sha256(difference.encode()).hexdigest()[:8]}"


def kept_rows(path: Path, where: dict[str, object]) -> list[dict[str, Any]]:
    """The rows of an earlier run of the same commit on the same machine, from the JSON it wrote."""
    if not path.exists():
        return []
    content = json.loads(path.read_text())
    same = all(content[name] == where[name] for name in ("commit", "machine"))
    return list(content["rows"]) if same else []


def write_json(path: Path, content: object) -> None:
    """Whole or not at all: an interrupted benchmark leaves the results before it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, (json.dumps(content, indent=1, allow_nan=False) + "\n").encode())


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout if done.returncode == 0 else ""


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or "unknown"
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else "unknown"


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
