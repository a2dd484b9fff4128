"""Rate and distortion, beside other codecs and published results."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmarks.commands import RESULTS, report
from tests.harness.data import PHOTOGRAPHS, ROOT

pytestmark = pytest.mark.thorough


def rd(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run benchmarks.rd on the small photographs, of 96 x 128 pixels."""
    command = [sys.executable, "-m", "benchmarks.rd", "--images", str(PHOTOGRAPHS), *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)


def test_other_codecs_are_within_the_rate(tmp_path: Path) -> None:
    for name in ("imagecodecs", "jpeglib", "pillow_heif"):
        pytest.importorskip(name)
    out = tmp_path / "rd.json"
    options = ["--most", "1", "--profiles", "", "--bpp", "1,4", "--rivals"]
    ran = rd(*options, "--out", str(out))
    assert ran.returncode == 0, ran.stderr
    content = json.loads(out.read_text())
    rows = {(row["codec"], row["max_bpp"]): row for row in content["rows"]}
    names = ["jpeg", "mozjpeg", "jpeg2000", "webp", "jpegxl", "heic", "avif tune=psnr", "avif tune=iq", "avif grain"]
    assert list(rows) == [(name, bpp) for name in names for bpp in (1, 4)]
    for (name, bpp), row in rows.items():
        assert row["bytes"] <= bpp * 96 * 128 / 8 or name == "jpeg"  # whose headers alone are 600 bytes
        assert row["bpp"] == 8 * row["bytes"] / (96 * 128)
    for name in names:
        assert 18 < rows[name, 1]["psnr"] < rows[name, 4]["psnr"]
    assert len({rows[name, 4]["psnr"] for name in names}) == len(names)  # no two are the same by another name
    assert rows["avif tune=psnr", 4]["psnr"] > rows["avif tune=iq", 4]["psnr"]
    assert all(name in ran.stdout for name in ("libavif-", "mozjpeg-", "libjxl-", "libheif-", "x265"))
    assert content["settings"]["codecs"]


# A codec with files of quality² bytes, and what its search finds from everywhere: quality, bytes, and what was tried.
SQUARE = (
    "import json, sys\n"
    "import numpy as np\n"
    "from benchmarks.rd.rivals import Rival\n"
    "class Square(Rival):\n"
    "    qualities = range(1, 11)\n"
    "    def encode(self, pixels, quality):\n"
    "        assert pixels.shape == (1, 8, 3)\n"
    "        tried.append(quality)\n"
    "        return bytes(int(quality) ** 2)\n"
    "found = []\n"
    "for near in (None, *Square.qualities):\n"
    "    tried = []\n"
    "    file = Square().best(np.zeros((1, 8, 3), np.uint8), int(sys.argv[1]), near)\n"
    "    found.append([near, file.quality, len(file.data), tried])\n"
    "print(json.dumps(found))\n"
)


@pytest.mark.parametrize("max_bytes", [0, 1, 4, 40, 99, 100, 500])
def test_the_search_finds_the_best_file_wherever_it_begins(max_bytes: int) -> None:
    command = [sys.executable, "-c", SQUARE, str(max_bytes)]
    ran = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    best = max(1, min(10, math.isqrt(max_bytes)))
    found = json.loads(ran.stdout)
    assert [near for near, *_ in found] == [None, *range(1, 11)]
    for near, quality, size, tried in found:
        assert (quality, size) == (best, best**2)
        assert len(tried) == len({*tried})  # no file is made twice
        assert near is None or abs(near - best) > 1 or len(tried) <= 3


def test_rows_say_how_they_were_made(tmp_path: Path) -> None:
    out = ["--most", "1", "--effort", "1", "--out", str(tmp_path / "rd.json")]
    ran = rd("--quality", "20,30", *out)
    assert ran.returncode == 0, ran.stderr
    rows = json.loads((tmp_path / "rd.json").read_text())["rows"]
    assert [(row["codec"], row["quality"], row["max_bpp"], row["effort"]) for row in rows] == [
        (f"{name} effort 1 one quality", quality, None, 1) for name in ("rd", "rd visual") for quality in (20, 30)
    ]
    assert all(coarse["bytes"] < fine["bytes"] for coarse, fine in (rows[:2], rows[2:]))
    assert "| rd effort 1 one quality | 20 | 1 |" in ran.stdout
    again = rd("--quality", "20,30", *out)
    assert "codec rd" not in again.stdout  # nothing is done twice


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--profiles", "rd,none"], "none: no such profile"),
        (["--quality", "50", "--rivals"], "--quality is for profile rd alone"),
        (["--quality", "0"], "--quality takes numbers above 0"),
        (["--bpp", "0"], "--bpp and --most take numbers above 0"),
        (["--weights", "nowhere"], "nowhere is no folder"),
    ],
)
def test_what_cannot_be_measured_is_refused_in_a_line(arguments: list[str], said: str) -> None:
    ran = rd(*arguments)
    assert ran.returncode == 2
    assert said in ran.stderr
    assert "Traceback" not in ran.stderr


def row_of(codec: str, image: str, aim: float, bpp: float, db: float) -> dict[str, object]:
    """One of made-up figures."""
    aims = {"max_bpp": None, "quality": aim} if "one quality" in codec else {"max_bpp": aim}
    figures = {"bytes": 1, "bpp": bpp, "psnr": db, "ms_ssim": 0.9, "gaussians": None, "encode_s": 1.0, "decode_ms": 1.0}
    return {"codec": codec, "image": image, **aims, **figures}


def test_rates_are_compared_with_what_averages_alike(tmp_path: Path) -> None:
    results = tmp_path / "benchmarks" / "results"
    shutil.copytree(RESULTS, results)
    shutil.copy(ROOT / "README.md", tmp_path)
    content = json.loads((results / "rd/kodak.json").read_text())
    published = json.loads((ROOT / "benchmarks" / "published" / "kodak.json").read_text())["AV1 (libaom)"]["points"]
    two = [  # their means are AV1's, none of the two is
        row_of("rd one quality", image, 10 * k, point["bpp"] * factor, point["psnr"] + 2 * (1 - factor))
        for k, point in enumerate(published, 1)
        for image, factor in (("kodim13.png", 1.5), ("kodim23.png", 0.5))
    ]
    (results / "rd/quality.json").write_text(json.dumps({**content, "rows": two}))
    low = [(0.15, 22.0), (0.25, 23.5), (0.4, 25.0)]
    high = [(0.15, 33.8), (0.25, 36.0), (0.4, 38.0)]
    seen = {"ssimulacra2": 50.0, "lpips": 0.25, "dists": 0.125}
    content["rows"] = [row_of("avif tune=iq", "kodim13.png", 0.15, 0.14, 21.0) | seen]
    content["rows"] += [
        row_of("rd", image, bpp, bpp, db) | seen
        for image, points in (("kodim13.png", low), ("kodim23.png", high))
        for bpp, db in points
    ]
    for codec, points in (
        ("avif tune=psnr", [(0.15, 0.15, 20.0), (0.25, 0.25, 22.0), (0.4, 0.4, 24.0)]),
        ("webp", [(0.1, 0.3, 22.0), (0.15, 0.3, 22.0), (0.6, 0.6, 24.0)]),  # whose smallest file serves twice
    ):
        content["rows"] += [row_of(codec, "kodim13.png", *point) for point in points]
    (results / "rd/kodak.json").write_text(json.dumps(content))
    effort = {"rows": [row_of("rd effort 9", "kodim13.png", 0.15, 0.15, 22.5)]}
    (results / "rd/effort.json").write_text(json.dumps(content | effort))
    ran = report(tmp_path)
    assert ran.returncode == 0, ran.stderr
    made = (tmp_path / "docs" / "results" / "rate.md").read_text()
    assert re.search(r"0\.0 % (more|fewer) bits than AV1 \(libaom\)", made)
    rd = "`rd`, tuned for PSNR"
    assert f"| {rd} | 29.75 | 50.0 | 0.250 | 0.125 | 1 | 1 | -" in made
    assert "| WebP, method 6" not in made  # it has no file at the table's rate
    assert re.search(r"[0-9.]+ % fewer bits than WebP", made)  # by two files, not three
    rates = (results / "csv" / "rd" / "kodak.csv").read_text()
    assert "rd,0.15,2,1,0.15,27.9,0.9,1,1,50,0.25,0.125" in rates
