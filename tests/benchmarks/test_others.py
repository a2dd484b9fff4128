"""Methods of others, fitted in plain torch."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmarks.commands import run
from tests.harness.data import PHOTOGRAPHS, ROOT

pytestmark = pytest.mark.thorough

# Two Gaussians at one place, the nearer of them red and half opaque, the other blue; a third lies elsewhere, unseen.
BLENDED = (
    "import json, torch, numpy as np\n"
    "from benchmarks.others.splats import FlatSplats, Splats, packed, unpacked\n"
    "shown = []\n"
    "for kind in (Splats, FlatSplats):\n"
    "    splats = kind(np.zeros((24, 32, 3), np.uint8), 3)\n"
    "    splats.values |= {'means': torch.tensor([[8.5, 8.5], [8.5, 8.5], [28.0, 20.0]]),\n"
    "        'colors': torch.tensor([[0.0, 0, 1], [1, 0, 0], [1, 1, 1]]), 'depths': torch.tensor([[2.0], [1], [3]]),\n"
    "        'opacities': torch.tensor([[0.0], [0], [-99]]), 'scales': torch.zeros(3, kind.scales)}\n"
    "    picture = splats.picture()\n"
    "    shown.append([picture[8, 8].tolist(), picture[20, 28].tolist(), picture[8, 9].tolist()])\n"
    "values = np.random.default_rng(0).normal(size=(50, 3))\n"
    "(one, other), whole = unpacked(packed([(values, 12), (np.arange(64.0)[:, None], 6)])), np.arange(64)\n"
    "error = np.abs(one - values) / np.ptp(values, axis=0)\n"
    "print(json.dumps([shown, float(error.max()), float(np.abs(other[:, 0] - whole).max())]))\n"
)


def test_splats_are_blended_and_packed() -> None:
    command = [sys.executable, "-c", BLENDED]
    ran = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    shown, error, of_integers = json.loads(ran.stdout)
    for middle, elsewhere, beside in shown:
        assert middle == [128, 0, 64]  # half of red, and half of what is left of blue
        assert elsewhere == [0, 0, 0]
        assert beside[0] == 81  # a variance of 1, and 0.1 of the pixel: exp(-1 / 2.2) / 2
    assert error < 0.51 / 4095
    assert of_integers < 1e-4


TABLES = (
    "import json, sys; from pathlib import Path; from benchmarks.others.report import summary\n"
    "print(*summary(json.loads(Path(sys.argv[1]).read_text())))\n"
)


def test_methods_of_others_are_fitted_and_shown(tmp_path: Path) -> None:
    out = tmp_path / "others.json"
    words = ["--images", str(PHOTOGRAPHS), "--most", "1", "--sides", "96,72", "--seconds", "0.2", "--bpp", "2.5"]
    run("others", out, *words)
    rows = {row["method"]: row for row in json.loads(out.read_text())["rows"]}
    assert list(rows) == ["paper", "ingp", "neurbf", "2dgs", "3dgs", "rd"]
    for name, row in rows.items():
        assert row["psnr"] > 8, name
        if row["table"] == "compression":
            assert 1000 < row["bytes"] <= 2.5 * 96 * 72 / 8
        else:
            assert 0.95 < row["numbers"] / rows["paper"]["numbers"] <= 1
    command = [sys.executable, "-c", TABLES, str(out)]
    shown = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    lines = {line.split(" | ")[0]: line for line in shown.splitlines()}
    assert lines["| I-NGP"].endswith(" | 43.88 |")  # as quoted
    assert lines["| 2DGS"].split(" | ")[1] == f"{rows['2dgs']['bytes']:,}"
