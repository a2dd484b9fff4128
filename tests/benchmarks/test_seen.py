"""Means of what people see, and sheets that hide names."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.harness.data import ROOT

pytestmark = pytest.mark.thorough

MEANS = (
    "import json; from benchmarks.perceptual.means import means\n"
    "row = {'max_bpp': 0.1, 'bytes': 1, 'texture': 0.0, 'psnr': 30.0}\n"
    "kinds = {'a.png': ('visual', 'avif', 'jpegxl'), 'b.png': ('visual', 'avif'), 'c.png': ('visual',)}\n"
    "found = means([row | {'image': image, 'kind': kind} for image, of in kinds.items() for kind in of], 0.1)\n"
    "print(json.dumps({kind: [mean['pictures'], mean['wasserstein']] for kind, mean in found.items()}))\n"
)
LEVELS = {"source": 0, "visual": 100, "avif": 200}
SIDE, MARGIN = (300, 220), 22  # of a part on the sheet
SHEET = (
    "import sys; import numpy as np; from benchmarks.perceptual import sheet\n"
    f"made = [(name, name, np.full((150, 200, 3), level, np.uint8)) for name, level in {LEVELS}.items()]\n"
    "sheet.made_by = lambda *_: made\n"
    "sheet.main()\n"
)


def ran(script: str, *words: str) -> str:
    command = [sys.executable, "-c", script, *words]
    return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout


def test_a_codec_that_lacks_a_picture_has_no_mean() -> None:
    """Older rows lack a figure."""
    assert json.loads(ran(MEANS)) == {"visual": [2, None], "avif": [2, None]}


def test_a_blind_sheet_hides_names_and_keeps_a_key(tmp_path: Path) -> None:
    Image.new("RGB", (200, 150)).save(tmp_path / "a.png")
    out = tmp_path / "blind.png"
    parts = "a:0:0,a:9:9,a:3:3,a:4:4"
    ran(SHEET, "--images", str(tmp_path), "--parts", parts, "--blind", "1", "--out", str(out))
    drawn, orders = np.asarray(Image.open(out).convert("L")), set()
    for row, line in enumerate((tmp_path / "blind.txt").read_text().splitlines()):
        middle = row * (SIDE[1] + MARGIN) + MARGIN + SIDE[1] // 2
        columns = [int(drawn[middle, k * SIDE[0] + SIDE[0] // 2]) for k in range(3)]
        order = [word.split()[1] for word in line.split(": ")[1].split(", ")]
        assert columns == [0, *(LEVELS[name] for name in order)]
        orders.add(tuple(order))
    assert len(orders) == 2  # both ways round
