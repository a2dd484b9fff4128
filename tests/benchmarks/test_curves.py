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


def test_curves_of_every_method(tmp_path: Path) -> None:
    methods = ["rd", "paper", "plain Adam", "siren", "hash grid"]
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


def test_few_rows_make_a_section(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    few = {
        "one limit": [a_curve("rd", "8 s")],
        "paper alone": [a_curve("paper")],
        "an old network": [a_curve("siren")],  # as before LPIPS was measured on the way
        "one without LPIPS": [a_curve("siren", lpips_curve=[[1.0, 0.5]]), a_curve("rd", lpips=None)],
        "another codec alone": [a_curve("jpeg", "0", curve=None)],
    }
    content = {"command": "c", "commit": "0", "date": "d", "settings": {"bpp": 0.25, "seconds": 60.0}}
    machine = {"processor": "p", "cores": 2, "instruction_set": "AVX2", "python": "3", "packages": {"torch": "2"}}
    script = (
        "from pathlib import Path; from benchmarks.report import convergence, plots\n"
        f"for name, rows in {few!r}.items():\n"
        f"    s = convergence.whole({content | {'machine': machine}!r} | {{'rows': rows}})\n"
        f"    plots.save(s.panels, s.title, s.of, Path({str(tmp_path)!r}) / name)\n"
        "    assert '30.00' in s.text(), name\n"
    )
    subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=True)
    for name in few:
        assert (tmp_path / f"{name}.svg").stat().st_size > 0


def test_every_setting_of_other_codecs_is_told_beside_ours() -> None:
    found = {"4": (29.0, 0.3, 2.0), "0": (31.0, 0.6, 20.0)}
    others = [
        a_curve("avif", setting, psnr=psnr, lpips=lpips, seconds=seconds, curve=None)
        for setting, (psnr, lpips, seconds) in found.items()
    ]
    ours = [a_curve("rd"), a_curve("rd", "effort 1", psnr=28.0, seconds=0.4), a_curve("rd visual", lpips=0.2)]
    rows = [*ours, *others]
    script = f"from benchmarks.report import convergence as c; rows = {rows!r}; "
    script += "print(c.best_of_others(12, rows)); print(c.curves(rows))"
    ran = subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=True, capture_output=True, text=True)
    told, curves = ran.stdout.splitlines()
    assert told == (
        "At 12 megapixels rd, tuned for PSNR, has 30.00 dB after 1.0 s, the best of other codecs 31.00 dB after 20.0 s "
        "(avif, tune=psnr speed 0); rd, tuned for the eye, has LPIPS 0.200 after 1.0 s, the best of other codecs LPIPS "
        "0.300 after 2.0 s (avif, tune=psnr speed 4)."
    )
    assert ast.literal_eval(curves) == [("rd, efforts", [(0.4, 28.0), (1.0, 30.0)])]  # no limits, so no line of them


def test_more_effort_or_time_that_is_worse_is_told() -> None:
    rows = [
        *(a_curve("rd", f"effort {effort}", psnr=psnr) for effort, psnr in ((9, 31.0), (1, 28.0), (3, 30.5))),
        *(a_curve("paper", setting, psnr=psnr) for setting, psnr in (("", 29.0), ("10 s", 29.05), ("3 s", 28.0))),
        *(a_curve("rd visual", setting, psnr=psnr) for setting, psnr in (("", 20.0), ("effort 1", 25.0))),
        a_curve("rd"),
    ]
    script = f"from benchmarks.report import convergence as c; print(c.worse_for_more({rows!r}))"
    ran = subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=True, capture_output=True, text=True)
    assert ran.stdout == (
        "More time or effort made a file worse by more than 0.1 dB: rd, efforts, 1 of 3 times, by 0.50 dB at most "
        "(a, 0.4 megapixels, effort 3 to nothing set).\n"
    )


def test_a_network_is_looked_at_on_some_of_its_pixels() -> None:
    script = (
        "from benchmarks import networks as n; network = n.hash_grid(n.np.zeros((10, 13, 3), n.np.uint8), 900); "
        "whole, some = n.drawn(network, (10, 13, 3)), n.drawn(network, (10, 13, 3), 3); "
        "print(some.shape, (whole[::3, ::3] == some).all())"
    )
    ran = subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=True, capture_output=True, text=True)
    assert ran.stdout == "(4, 5, 3) True\n"
