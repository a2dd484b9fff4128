"""Time and memory, of files and of a service under attack."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.benchmarks.commands import run
from tests.harness.data import ROOT


def test_files_of_so_many_gaussians_are_timed(tmp_path: Path) -> None:
    out = tmp_path / "speed.json"
    few = ["--gaussians", "20,40", "--repeats", "1", "--steps", "10", "--rounds", "1"]
    run("speed", out, "--only", "gaussians", *few)
    rows = [row for row in json.loads(out.read_text())["rows"] if row["what"] == "file"]
    assert [row["asked"] for row in rows] == [20, 40]
    assert all(0 < row["gaussians"] <= row["asked"] and row["decode_ms"] > 0 for row in rows)
    assert all({*row["rivals_bytes"]} == {*row["rivals_encode_s"]} == {*row["rivals_decode_ms"]} for row in rows)
    script = (
        f"import json; from benchmarks.report import speed; print(speed.section(json.load(open({str(out)!r}))).text())"
    )
    options: dict[str, Any] = {"input": out.read_text(), "capture_output": True, "text": True}
    ran = subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=True, **options)
    assert "With the Gaussians to the power of" in ran.stdout
    assert re.search(r"^\| 40 \|", ran.stdout, re.MULTILINE)


def test_an_attack_is_measured(tmp_path: Path) -> None:
    out = tmp_path / "attacks.json"
    run("attacks", out, "--seconds", "2", "--only", "slow", check=False)
    (row,) = json.loads(out.read_text())["rows"]
    assert sum(other["requests"] for other in row["others"].values()) == 74
    assert (row["tracebacks"], row["exit_status"]) == (0, 0)
