"""Documents against the JSON of benchmarks/results, and the form of each JSON."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.harness.data import ROOT

RESULTS = ROOT / "benchmarks" / "results"
JSONS = sorted(RESULTS.rglob("*.json"))


def checked(root: Path) -> subprocess.CompletedProcess[str]:
    """What the report says of the documents below a folder."""
    command = [sys.executable, "-m", "benchmarks.report", "--root", str(root), "--check"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=100)


def test_documents_are_what_the_json_says() -> None:
    ran = checked(ROOT)
    assert (ran.returncode, ran.stderr) == (0, "")


@pytest.mark.parametrize(("name", "documents"), [("rd/kodak", {"rate.md", "README.md", "kodak.csv"})])
def test_a_document_that_differs_is_named(tmp_path: Path, name: str, documents: set[str]) -> None:
    for folder in ("benchmarks/results", "docs/results"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    shutil.copy(ROOT / "README.md", tmp_path)
    path = tmp_path / "benchmarks" / "results" / f"{name}.json"
    content = json.loads(path.read_text())
    content["commit"] = "0123456789ab"
    for row in content["rows"]:
        row["psnr"] += 1
    path.write_text(json.dumps(content))
    ran = checked(tmp_path)
    assert ran.returncode == 1
    named, _, said = ran.stderr.partition(": ")
    assert said.startswith("not what the JSON says")
    assert documents <= {Path(name).name for name in named.split(", ")}


@pytest.mark.parametrize("path", JSONS, ids=lambda path: str(path.relative_to(RESULTS)))
def test_results_say_where_they_come_from(path: Path) -> None:
    content = json.loads(path.read_text())
    assert {"command", "commit", "date", "machine", "settings", "rows"} <= set(content)
    assert re.fullmatch(r"(SG_THREADS=\d+ )?python -m benchmarks\.\w+[^/]*", content["command"])  # no path of a machine
    assert re.fullmatch(r"[0-9a-f]{12}(\+[0-9a-f]{8})?", content["commit"])
    assert {"processor", "cores", "instruction_set", "system", "python", "packages"} <= set(content["machine"])
    assert content["rows"]
