"""The documents against the JSON of benchmarks/results, and the form that each JSON has."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.harness.data import PHOTOGRAPHS, ROOT

RESULTS = ROOT / "benchmarks" / "results"
JSONS = sorted(RESULTS.rglob("*.json"))


def report(root: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run benchmarks.report on a folder."""
    command = [sys.executable, "-m", "benchmarks.report", "--root", str(root), *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=100)


def test_documents_are_what_the_json_says() -> None:
    ran = report(ROOT, "--check")
    assert (ran.returncode, ran.stderr) == (0, "")


def spoil_rate(content: Any) -> None:
    content["rows"][0]["psnr"] += 1


def spoil_origin(content: Any) -> None:
    content["commit"] = "0123456789ab"


@pytest.mark.parametrize(
    ("name", "spoil", "documents"),
    [
        ("kodak-rd", spoil_rate, "results.md and README.md"),
        ("version4/turns", lambda content: content["rows"][0]["this"].update(psnr=1.0), "README.md"),
        ("ablation", spoil_origin, "results.md"),
    ],
)
def test_a_document_that_differs_is_named(
    tmp_path: Path, name: str, spoil: Callable[[Any], None], documents: str
) -> None:
    shutil.copytree(RESULTS, tmp_path / "benchmarks" / "results")
    (tmp_path / "docs").mkdir()
    for document in ("README.md", "docs/results.md"):
        shutil.copy(ROOT / document, tmp_path / document)
    path = tmp_path / "benchmarks" / "results" / f"{name}.json"
    content = json.loads(path.read_text())
    spoil(content)
    path.write_text(json.dumps(content))
    ran = report(tmp_path, "--check")
    assert ran.returncode == 1
    assert ran.stderr.startswith(f"{documents}: not what the JSON says")


def test_every_plot_is_there() -> None:
    named = re.findall(r"\]\((plots/\S+)\)", (ROOT / "docs" / "results.md").read_text())
    assert named
    for name in named:
        for suffix in (".svg", ".png"):
            assert (ROOT / "docs" / name).with_suffix(suffix).stat().st_size > 1000


@pytest.mark.parametrize("path", JSONS, ids=lambda path: str(path.relative_to(RESULTS)))
def test_results_say_where_they_come_from(path: Path) -> None:
    content = json.loads(path.read_text())
    assert {"command", "commit", "date", "machine", "settings", "rows"} <= set(content)
    assert re.fullmatch(r"python -m benchmarks\.\w+[^/]*", content["command"])  # no path of a machine
    assert re.fullmatch(r"[0-9a-f]{12}(\+[0-9a-f]{8})?", content["commit"])
    assert {"processor", "cores", "instruction_set", "system", "python", "packages"} <= set(content["machine"])
    assert content["rows"]


def test_curves_of_every_method(tmp_path: Path) -> None:
    methods = ["rd", "plain Adam", "siren", "hash grid"]
    out = tmp_path / "convergence.json"
    sizes = ["--images", str(PHOTOGRAPHS), "--most", "1", "--megapixels", "0.002", "--bpp", "4"]
    times = ["--seconds", "0.4", "--limits", "0.3", "--methods", ",".join(methods), "--out", str(out)]
    command = [sys.executable, "-m", "benchmarks.convergence", *sizes, *times]
    subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, timeout=300)
    rows = json.loads(out.read_text())["rows"]
    assert [row["method"] for row in rows] == ["rd", "rd", *methods[1:]]
    assert [row["setting"] for row in rows] == ["", "0.3 s", "", "", ""]
    for row in rows:
        times_s = [seconds for seconds, _ in row["curve"]]
        assert times_s == sorted(times_s)
        assert row["psnr"] == pytest.approx(row["curve"][-1][1], abs=1e-3)
        assert row["bytes"] is None or row["bytes"] <= 1020  # 4 bits for each of about 2,000 pixels


def test_a_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    def run(scenes: str, side: str = "32") -> str:
        out = ["--out", str(tmp_path / "needs.json"), "--side", side, "--repeats", "1"]
        command = [sys.executable, "-m", "benchmarks.needs", "--scenes", scenes, *out]
        return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, timeout=300).stdout

    def rows() -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = json.loads((tmp_path / "needs.json").read_text())["rows"]
        return found

    run("flat")
    first = rows()
    assert first[0]["left_out_of_the_file"] == ["Gaussians"]
    assert first[0]["bits"]["payload"] == 0
    assert run("flat,grey").startswith("scene grey")
    assert rows()[:1] == first
    assert "chroma" in rows()[1]["left_out_of_the_file"]
    run("flat", side="33")  # another setting, another run
    assert [row["scene"] for row in rows()] == ["flat"]


def test_an_attack_is_measured(tmp_path: Path) -> None:
    out = tmp_path / "attacks.json"
    command = [sys.executable, "-m", "benchmarks.attacks", "--seconds", "2", "--only", "slow", "--out", str(out)]
    subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)
    (row,) = json.loads(out.read_text())["rows"]
    assert sum(other["requests"] for other in row["others"].values()) == 74
    assert (row["tracebacks"], row["exit_status"]) == (0, 0)
