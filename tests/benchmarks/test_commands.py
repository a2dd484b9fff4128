"""Each command that benchmarks lists, on one small picture. Slow: each starts Python anew."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from PIL import Image

from benchmarks.machine import rows_of
from tests.support.data import PHOTOGRAPHS, ROOT

pytestmark = pytest.mark.thorough

# Its arguments, what tells its rows apart, and what these come to.
COMMANDS: dict[str, tuple[str, str, list[object]]] = {
    "rd": (
        "--images {small} --bpp 2 --effort 1",
        "codec",
        ["rd effort 1", "rd fidelity effort 1", "rd visual effort 1"],
    ),
    "convergence": (
        "--images {small} --megapixels 0.002 --bpp 4 --few --methods rd --limits 0.3",
        "setting",
        ["", "0.3 s", "effort 1", "effort 3", "effort 7"],
    ),
    "speed kernels": ("--steps 10 --rounds 1", "job", ["binning", "forward", "forward + backward"]),
    "speed growth": (
        "--images {small} --megapixels 0.002 --at-bytes 250 --bytes 120 --at-megapixels 0.002 --repeats 1",
        "max_bytes",
        [250, 120],
    ),
    "ablation": (
        "--images {small} --tables positions --seeds 1 --fit-steps 60 --tune-steps 20",
        "setting",
        ["16", "14", "12", "10"],
    ),
    "ablation --tables bitwidths": ("--images {small} --seeds 1 --fit-steps 60 --tune-steps 20", "asked", [3000]),
    "ablation gains": (
        "--images {small} --tables crops,numbers --numbers 30000,50000 --steps 20",
        "setting",
        ["random", "dynamic", "fixed"],
    ),
    "robustness stiff": ("--pictures pixel-1x1,row-300x1 --only bpp", "value", [0.1, 0.3, 1, 2, 4, 8]),
    "robustness extremes": (
        "--sets fits --cases 'photograph, profile rd, every second mean not a number at the start'",
        "verdict",
        ["kept"],
    ),
    "robustness order": ("--images {small} --megapixels 0.002 --bpp 2 --efforts 1,2", "effort", [1, 2]),
    "gpu": ("--quick --images {small}", "what", ["decode", "decode bytes"]),
    "service attacks": ("--seconds 2 --only slow", "tracebacks", [0]),
}


def run(module: str, out: Path, *arguments: str, check: bool = True) -> None:
    """Run a command of benchmarks, or a part of one."""
    command = [sys.executable, "-m", *f"benchmarks.{module}".split(), *arguments, "--out", str(out)]
    subprocess.run(command, cwd=ROOT, capture_output=True, check=check, timeout=300)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one picture of 64 x 48 pixels."""
    folder = tmp_path_factory.mktemp("small")
    with Image.open(PHOTOGRAPHS / "kodim05-crop.png") as picture:
        picture.crop((0, 0, 64, 48)).save(folder / "small.png")
    return folder


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_measures(command: str, tmp_path: Path, small: Path) -> None:
    if command == "gpu" and find_spec("triton") is None:
        pytest.skip("benchmarks.gpu needs Triton: pip install '.[gpu]'")
    line, field, wanted = COMMANDS[command]
    out = tmp_path / "rows.json"
    run(command, out, *shlex.split(line.format(small=small)), check=command != "service attacks")
    rows = rows_of(json.loads(out.read_text()))
    assert list(dict.fromkeys(row[field] for row in rows if field in row)) == list(dict.fromkeys(wanted))
    assert all(row["psnr"] > 8 for row in rows if row.get("psnr"))


def test_other_codecs_come_at_exactly_the_rate(tmp_path: Path) -> None:
    pytest.importorskip("imagecodecs")
    out, codecs = tmp_path / "rd.json", ("--baselines", "avif tune=ssimulacra2")
    ours = ("--most", "1", "--bpp", "0.35", "--tune", "fidelity", "--effort", "1")
    run("rd", out, "--images", str(PHOTOGRAPHS), *ours, "--equal", *codecs)
    rows = {row["codec"]: row for row in rows_of(json.loads(out.read_text()))}
    assert list(rows) == ["rd fidelity effort 1", "avif tune=ssimulacra2"]
    assert rows["avif tune=ssimulacra2"]["bpp"] == 0.35
    assert 0.33 < rows["rd fidelity effort 1"]["bpp"] <= 0.35


def test_other_codecs_are_within_the_rate(tmp_path: Path) -> None:
    for name in ("imagecodecs", "jpeglib", "pillow_heif", "pyvips"):
        pytest.importorskip(name)
    out = tmp_path / "rd.json"
    arguments = ("--images", str(PHOTOGRAPHS), "--most", "1", "--profiles", "", "--bpp", "1,4", "--baselines")
    run("rd", out, *arguments)
    rows = {(row["codec"], row["max_bpp"]): row for row in rows_of(json.loads(out.read_text()))}
    names = ["jpeg", "mozjpeg", "webp", "jpegxl", "heic", "avif tune=psnr"]
    names += ["avif tune=psnr 10 bits", "avif tune=iq 4:4:4", "avif tune=iq 10 bits"]
    assert list(rows) == [(name, bpp) for name in names for bpp in (1, 4)]
    for (name, bpp), row in rows.items():
        assert row["bytes"] <= bpp * 96 * 128 / 8 or name == "jpeg"  # whose headers alone are 600 bytes
    assert all(18 < rows[name, 1]["psnr"] < rows[name, 4]["psnr"] for name in names)
    assert len({rows[name, 4]["psnr"] for name in names}) == len(names)  # no two are the same by another name
