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


def rd(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run benchmarks.rd on the small photographs, of 96 x 128 pixels."""
    command = [sys.executable, "-m", "benchmarks.rd", "--images", str(PHOTOGRAPHS), *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)


def numbers_of(width: int, hidden: int) -> int:
    """Of a network with a first layer of two inputs, hidden layers, and a last one of three colours."""
    return (2 + 1) * width + hidden * (width + 1) * width + (width + 1) * 3


def test_other_codecs_are_within_the_rate(tmp_path: Path) -> None:
    for name in ("imagecodecs", "jpeglib", "pillow_heif"):
        pytest.importorskip(name)
    out = tmp_path / "rd.json"
    options = ["--most", "1", "--profiles", "", "--bpp", "1,4", "--rivals", "--coin", "--coin-seconds", "0.3"]
    ran = rd(*options, "--out", str(out))
    assert ran.returncode == 0, ran.stderr
    content = json.loads(out.read_text())
    rows = {(row["codec"], row["max_bpp"]): row for row in content["rows"]}
    names = ["jpeg", "mozjpeg", "jpeg2000", "webp", "jpegxl", "heic", "avif tune=psnr", "avif tune=iq", "avif grain"]
    assert list(rows) == [(name, bpp) for name in [*names, "coin"] for bpp in (1, 4)]
    for (name, bpp), row in rows.items():
        assert row["bytes"] <= bpp * 96 * 128 / 8 or name == "jpeg"  # whose headers alone are 600 bytes
        assert row["bpp"] == 8 * row["bytes"] / (96 * 128)
    for name in names:
        assert 18 < rows[name, 1]["psnr"] < rows[name, 4]["psnr"]
    assert len({rows[name, 4]["psnr"] for name in names}) == len(names)  # no two are the same by another name
    assert rows["avif tune=psnr", 4]["psnr"] > rows["avif tune=iq", 4]["psnr"]
    for bpp, width in ((1, 8), (4, 17)):
        assert (
            rows["coin", bpp]["bytes"] == 2 * numbers_of(width, 9) <= bpp * 96 * 128 / 8 < 2 * numbers_of(width + 1, 9)
        )
    assert all(name in ran.stdout for name in ("libavif-", "mozjpeg-", "libjxl-", "libheif-", "x265"))
    assert content["settings"]["codecs"]


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
    (tmp_path / "docs").mkdir()
    shutil.copy(ROOT / "README.md", tmp_path)
    content = json.loads((results / "kodak-rd.json").read_text())
    published = json.loads((ROOT / "benchmarks" / "published" / "kodak.json").read_text())["AV1 (libaom)"]["points"]
    two = [  # their means are AV1's, none of the two is
        row_of("rd one quality", image, 10 * k, point["bpp"] * factor, point["psnr"] + 2 * (1 - factor))
        for k, point in enumerate(published, 1)
        for image, factor in (("kodim13.png", 1.5), ("kodim23.png", 0.5))
    ]
    (results / "kodak-quality.json").write_text(json.dumps({**content, "rows": two}))
    low = [(0.15, 22.0), (0.25, 23.5), (0.4, 25.0)]
    high = [(0.15, 33.8), (0.25, 36.0), (0.4, 38.0)]
    seen = {"ssimulacra2": 50.0, "lpips": 0.25, "dists": 0.125}
    content["rows"] = [row_of("avif tune=iq", "kodim13.png", 0.15, 0.14, 21.0) | seen]
    content["rows"] += [
        row_of("rd", image, bpp, bpp, db) | seen
        for image, points in (("kodim13.png", low), ("kodim23.png", high))
        for bpp, db in points
    ]
    (results / "kodak-rd.json").write_text(json.dumps(content))
    fitted = {"rows": [row_of("coin", "kodim13.png", 0.15, 0.149, 20.0)], "settings": {}}
    (results / "kodak-fitted.json").write_text(json.dumps(content | fitted))
    ran = report(tmp_path)
    assert ran.returncode == 0, ran.stderr
    made = (tmp_path / "docs" / "results.md").read_text()
    assert re.search(r"^\| `rd`, one quality \| AV1 \(libaom\), quoted \| [+-]0\.0 % \|", made, re.MULTILINE)
    assert "`rd`, one quality | GaussianImage" not in made  # whose means are of one rate
    (line,) = re.findall(r"^\| `rd` \|[^|]*\|[^|]* % \| ([^|]*) \|[^|]*\|$", made, re.MULTILINE)
    assert line.endswith(" % (1)")  # kodim23 has no point so low
    assert "| 0.15 | `rd` | 0.150 | 50.0 | 0.250 | 0.125 |" in made
    assert "| COIN | 0.15 | 1 | 1 | 0.1490 | 20.00 |" in made
    assert "| `rd` | 0.15 | 1 | 1 | 0.1500 | 22.00 |" in made  # on that picture alone, beside it
