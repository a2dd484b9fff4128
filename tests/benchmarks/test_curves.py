"""Error against run time."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmarks.commands import run
from tests.harness.data import PHOTOGRAPHS, ROOT

pytestmark = pytest.mark.thorough


def test_curves_of_every_method(tmp_path: Path) -> None:
    methods = ["rd", "paper", "plain Adam", "siren"]
    out = tmp_path / "convergence.json"
    sizes = ["--images", str(PHOTOGRAPHS), "--most", "1", "--megapixels", "0.002", "--bpp", "4", "--few"]
    times = ["--seconds", "0.4", "--limits", "0.3", "--paper-limits", "0.2", "--methods", ",".join(methods)]
    run("convergence", out, *sizes, *times)
    rows = json.loads(out.read_text())["rows"]
    efforts = [f"effort {effort}" for effort in (1, 3, 7)]
    assert [(row["method"], row["setting"]) for row in rows] == [
        *(("rd", ""), ("paper", ""), ("rd", "0.3 s"), ("paper", "0.2 s"), *(("rd", effort) for effort in efforts)),
        *((method, "") for method in methods[2:]),
    ]
    for row in rows:
        looked_at = [seconds for seconds, _ in row.get("lpips_curve", row["curve"][-1:])]
        assert {*looked_at} <= {seconds for seconds, _ in row["curve"]}
        assert looked_at[-1] == row["curve"][-1][0]
        times_s = [seconds for seconds, _ in row["curve"]]
        assert times_s == sorted(times_s)
        assert row["psnr"] == pytest.approx(row["curve"][-1][1], abs=1e-3)
        assert row["bytes"] is None or row["bytes"] <= 1020  # 4 bits for each of about 2,000 pixels


def test_lpips_on_the_way_is_that_of_whole_pictures() -> None:
    script = (
        "import numpy as np; from benchmarks.convergence.__main__ import learned; "
        "p = np.zeros((4, 4, 3), np.uint8); "
        "looks = [(0.1, (p + 9, p), True), (0.2, (p[::2] + 5, p[::2]), False), (0.3, (p + 2, p), True)]; "
        "start = lambda *_: iter(looks); "
        "print(learned(start, p, 1.0, 7, None, lambda picture, source: float(picture.max())))"
    )
    ran = subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=True, capture_output=True, text=True)
    row = ast.literal_eval(ran.stdout)
    assert row["lpips_curve"] == [[0.1, 9.0], [0.3, 2.0]]
    assert [seconds for seconds, _ in row["curve"]] == [0.1, 0.2, 0.3]
    assert (row["lpips"], row["seconds"]) == (2.0, 0.3)


def a_curve(method: str, setting: str = "", **more: object) -> dict[str, object]:
    figures = {
        "bytes": 9,
        "gaussians": 1,
        "seconds": 1.0,
        "psnr": 30.0,
        "lpips": 0.5,
        "curve": [[0.5, 29.0], [1.0, 30.0]],
    }
    return {"method": method, "setting": setting, "picture": "a", "megapixels": 0.4, **figures, **more}


@pytest.mark.parametrize(
    "rows",
    [
        [a_curve("rd", "8 s")],
        [a_curve("paper")],
        [a_curve("siren")],
        [a_curve("siren"), a_curve("rd"), a_curve("rd", "effort 1"), a_curve("avif", "6", curve=None, psnr=29.0)],
        [a_curve("jpeg", "0", curve=None)],
    ],
    ids=["one limit", "paper alone", "a network alone", "ours beside AVIF", "another codec alone"],
)
def test_few_rows_make_a_page(rows: list[dict[str, object]], tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    content = {"command": "c", "commit": "0", "date": "2026-01-01", "settings": {"bpp": 0.25}, "rows": rows}
    machine = {"processor": "p", "cores": 2, "instruction_set": "AVX2", "python": "3", "packages": {"torch": "2"}}
    script = (
        "from pathlib import Path; from benchmarks.report import speed, plots; "
        f"s = speed.page({{'convergence/kodak': {content | {'machine': machine}!r}}}); "
        f"plots.save(s.panels, s.title, s.of, Path({str(tmp_path / 'plot')!r})); print(s.text())"
    )
    ran = subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=True, capture_output=True, text=True)
    assert ("takes 1 times as long and gains 1.0 dB at 0.4 megapixels" in ran.stdout) == (len(rows) == 4)
    assert (tmp_path / "plot.svg").stat().st_size > 0


def test_a_network_is_looked_at_on_some_of_its_pixels() -> None:
    script = (
        "from benchmarks.convergence import network as n; network = n.siren(900); "
        "whole, some = n.drawn(network, (10, 13, 3)), n.drawn(network, (10, 13, 3), 3); "
        "print(some.shape, (whole[::3, ::3] == some).all())"
    )
    ran = subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=True, capture_output=True, text=True)
    assert ran.stdout == "(4, 5, 3) True\n"
