"""The command benchmarks.robustness stiff: its pictures, its rules on rows that are made up, and one tiny run.

Slow: each call starts Python with all that a benchmark imports.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from tests.harness.data import ROOT

pytestmark = pytest.mark.thorough


def stiff(*arguments: object) -> str:
    """What the command prints."""
    command = [sys.executable, "-m", "benchmarks.robustness", "stiff", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, timeout=600).stdout


def test_every_picture_is_drawn(tmp_path: Path) -> None:
    stiff("--draw", tmp_path)
    sizes = {path.stem: Image.open(path).size for path in tmp_path.glob("*.png")}
    assert len(sizes) == 26
    thin = {"row-300x1": (300, 1), "column-1x300": (1, 300), "pixel-1x1": (1, 1), "strip-4096x16": (4096, 16)}
    assert {name: size for name, size in sizes.items() if size != (256, 256)} == thin


def row(kind: str, value: float, size: int | None, psnr: float | None, **others: Any) -> dict[str, Any]:
    """A row of 65,536 pixels, so that 0.001 bpp are 8 bytes."""
    most = int(value * 8192) if kind == "bpp" else None
    return {"seed": 0, "kind": kind, "value": value, "bytes": size, "psnr": psnr, "max_bytes": most, **others}


# Rows of one picture, and how far each rule is broken by them.
CASES: dict[str, tuple[list[dict[str, Any]], list[tuple[str, float]]]] = {
    "all kept": (
        [
            *(row("bpp", 1, 8100, 30.0), row("bpp", 2, 16384, 33.0), row("bpp", 4, 32000, None)),
            *(row("psnr", 30, 8200, 30.05), row("psnr", 40, 31500, 40.0)),
            *(row("quality", 10, 500, 20.0), row("quality", 20, 500, 20.0), row("quality", 30, 8190, 29.95)),
        ],
        [],
    ),
    "failed": ([row("quality", 10, None, None, error="MemoryError: none left")], [("failed", 1)]),
    "refused": ([row("bpp", 0.001, None, None, refused="BudgetError: 8 bytes"), row("quality", 10, 20, 30.0)], []),
    "refused, but it would do": (
        [row("bpp", 0.001, None, None, refused="BudgetError: 8 bytes"), row("quality", 10, 8, 30.0)],
        [("failed", 1)],
    ),
    "falls": ([row("bpp", 1, 8192, 30.0), row("bpp", 2, 16384, 29.5), row("bpp", 4, 32768, 29.4)], [("falls", 0.6)]),
    "falls, but not where bytes grow": ([row("bpp", 1, 8000, 30.0), row("bpp", 1.001, 8000, 29.0)], []),
    "falls from exact": ([row("bpp", 1, 8192, None), row("bpp", 2, 16384, 40.0)], [("falls", 18.9)]),
    "exceeded": ([row("bpp", 1, 8193, 30.0), row("bpp", 2, 16384, 30.0)], [("exceeded", 1)]),
    "missed": ([row("psnr", 30, 900, 29.9), row("bpp", 1, 8192, 30.0)], [("missed", 0.1)]),
    "missed, but so do all": ([row("psnr", 30, 900, 29.9), row("bpp", 1, 8192, 29.9)], []),
    "clipped": ([row("quality", 10, 900, 30.0, clipped=3)], [("clipped", 3)]),
    "trace": ([row("quality", 10, 900, 30.0, traced=[890, 30.3, "joint"])], [("trace", 0.3)]),
    "trace, but little": ([row("quality", 10, 900, 30.0, traced=[890, 30.05, "joint"])], []),
}


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The JSON after all cases were judged, each as a picture of its own."""
    rows = [{**made_up, "picture": name} for name, (group, _) in CASES.items() for made_up in group]
    path = tmp_path_factory.mktemp("judged") / "rows.json"
    machine = {"processor": "abacus", "cores": 1, "instruction_set": "none"}
    path.write_text(json.dumps({"commit": "0", "date": "today", "machine": machine, "rows": rows}))
    stiff("--judge", "--out", path)
    return path


@pytest.mark.parametrize("case", CASES)
def test_rules(judged: Path, case: str) -> None:
    found = [v for v in json.loads(judged.read_text())["violations"] if v["picture"] == case]
    assert [(v["rule"], v["by"]) for v in found] == [(rule, pytest.approx(by, abs=1e-4)) for rule, by in CASES[case][1]]


def test_a_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    path = tmp_path / "rows.json"
    run = ("--pictures", "pixel-1x1,row-300x1", "--seeds", 1, "--out", path)
    first = stiff(*run, "--only", "bpp")
    rows = json.loads(path.read_text())["rows"]
    assert [row["value"] for row in rows] == 2 * [0.1, 0.3, 1, 2, 4, 8]
    assert all(f"{row['picture']}, seed 0, bpp {row['value']:g}: " in first for row in rows)
    assert {(row["error"], row["clipped"]) for row in rows} == {(None, 0)}
    for made in rows:
        assert (made["refused"] is None) == (made["bytes"] is not None)
        assert made["bytes"] is None or made["bytes"] <= made["max_bytes"]
    second = stiff(*run, "--only", "bpp,psnr")
    assert "bpp 8:" not in second
    assert "psnr 40:" in second
    assert json.loads(path.read_text())["rows"][: len(rows)] == rows
