"""Commands of benchmarks, and a copy of their results."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from tests.harness.data import ROOT

RESULTS = ROOT / "benchmarks" / "results"


def report(root: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run benchmarks.report on a folder."""
    command = [sys.executable, "-m", "benchmarks.report", "--root", str(root), *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=100)


def copied(folder: Path) -> Path:
    """The results in another folder, beside the documents that are made of them."""
    results = folder / "benchmarks" / "results"
    shutil.copytree(RESULTS, results)
    shutil.copytree(ROOT / "docs" / "results", folder / "docs" / "results")
    shutil.copy(ROOT / "README.md", folder)
    return results


def run(module: str, out: Path, *arguments: str, check: bool = True) -> subprocess.CompletedProcess[str]:
    """Run a command of benchmarks, or a part of one."""
    command = [sys.executable, "-m", *f"benchmarks.{module}".split(), *arguments, "--out", str(out)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=check, timeout=300)
