"""Time and memory, of files and of a service under attack."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmarks.commands import run
from tests.harness.data import PHOTOGRAPHS, ROOT

pytestmark = pytest.mark.thorough


def test_files_of_so_many_gaussians_are_timed(tmp_path: Path) -> None:
    out = tmp_path / "speed.json"
    few = ["--gaussians", "20,40", "--repeats", "1", "--steps", "10", "--rounds", "1"]
    run("speed", out, "--only", "gaussians", *few)
    rows = [row for row in json.loads(out.read_text())["rows"] if row["what"] == "file"]
    assert [row["asked"] for row in rows] == [20, 40]
    assert all(0 < row["gaussians"] <= row["asked"] and row["decode_ms"] > 0 for row in rows)
    assert all({*row["rivals_bytes"]} == {*row["rivals_encode_s"]} == {*row["rivals_decode_ms"]} for row in rows)


def test_growth_is_measured_along_both_axes(tmp_path: Path) -> None:
    out = tmp_path / "growth.json"
    sizes = ["--megapixels", "0.004,0.012", "--at-bytes", "250", "--bytes", "120,250", "--at-megapixels", "0.012"]
    few = ["--images", str(PHOTOGRAPHS), "--most", "1", "--repeats", "1"]
    printed = run("speed growth", out, *few, *sizes).stdout
    rows = json.loads(out.read_text())["rows"]
    ours = [row for row in rows if row["method"].startswith("rd")]
    wanted = [(0.004, 250), (0.012, 250), (0.012, 120)]  # the size that both axes share, once
    assert [(row["megapixels"], row["max_bytes"]) for row in ours] == [size for size in wanted for _ in range(2)]
    assert all(row["bytes"] <= row["max_bytes"] for row in ours)
    assert printed.count("| rd visual |") == 2
    assert run("speed growth", out, *few, *sizes[:1], "5", check=False).stderr.endswith("5 need a larger one\n")


def test_growth_is_told_with_its_power() -> None:
    """Seconds that grow with the square root of the bytes, and with the pixels."""
    rows = [
        {"method": "rd", "setting": "", "picture": "a", "megapixels": mp, "max_bytes": size, "seconds": s, "psnr": 30.0}
        for mp, size, s in ((1, 100, 1.0), (4, 100, 4.0), (4, 400, 8.0), (4, 1600, 16.0))
    ]
    rows.append({**rows[1], "method": "avif", "setting": "6", "seconds": 2.0})
    script = (
        f"from benchmarks.speed import growth; rows, fixed = {rows!r}, {{'megapixels': 4, 'max_bytes': 100}}; "
        "print(*(growth.growth_table(rows, fixed, axis) for axis in growth.AXES), sep='\\n')"
    )
    ran = subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=True, capture_output=True, text=True)
    lines = ran.stdout.splitlines()
    assert "| rd | 1.00 | 4.00 | 1.00 | 30.00 |" in lines
    assert "| rd | 4.00 | 8.00 | 16.00 | 0.50 | 30.00 |" in lines
    assert "| avif, speed 6 | 2.00 | - | - | - | - |" in lines


def test_avif_of_a_reduced_picture_makes_smaller_files() -> None:
    """A file of a quarter of the pixels, or fewer where bits are few; what it shows has the picture's size."""
    pytest.importorskip("imagecodecs")
    script = (
        "from benchmarks.rd.rivals import AvifForPsnr, ReducedAvif; from benchmarks.pictures import photograph; "
        "p = photograph(96); whole, small = AvifForPsnr(10), ReducedAvif(10); "
        "a, b, c = (r.best(p, bpp) for r, bpp in ((whole, 0.02), (small, 0.02), (small, 1))); "
        "print(len(a.data) > len(b.data), small._factor, small.decode(c.data).shape)"
    )
    ran = subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=True, capture_output=True, text=True)
    assert ran.stdout == "True 2 (96, 96, 3)\n"


def test_an_attack_is_measured(tmp_path: Path) -> None:
    out = tmp_path / "attacks.json"
    run("service attacks", out, "--seconds", "2", "--only", "slow", check=False)
    (row,) = json.loads(out.read_text())["rows"]
    assert sum(other["requests"] for other in row["others"].values()) == 74
    assert (row["tracebacks"], row["exit_status"]) == (0, 0)
