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
from PIL import Image

from tests.harness.data import PHOTOGRAPHS, ROOT

RESULTS = ROOT / "benchmarks" / "results"
JSONS = sorted(RESULTS.rglob("*.json"))


def report(root: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run benchmarks.report on a folder."""
    command = [sys.executable, "-m", "benchmarks.report", "--root", str(root), *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=100)


def copied(folder: Path) -> Path:
    """The results in another folder, beside the documents that are made of them."""
    results = folder / "benchmarks" / "results"
    shutil.copytree(RESULTS, results)
    (folder / "docs").mkdir()
    for document in ("README.md", "docs/results.md"):
        shutil.copy(ROOT / document, folder / document)
    return results


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
        ("rd/kodak", spoil_rate, "results.md and README.md"),
        ("version4/turns", lambda content: content["rows"][0]["this"].update(psnr=1.0), "README.md"),
        ("ablation", spoil_origin, "results.md"),
    ],
)
def test_a_document_that_differs_is_named(
    tmp_path: Path, name: str, spoil: Callable[[Any], None], documents: str
) -> None:
    path = copied(tmp_path) / f"{name}.json"
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
    assert re.fullmatch(r"(SG_THREADS=\d+ )?python -m benchmarks\.\w+[^/]*", content["command"])  # no path of a machine
    assert re.fullmatch(r"[0-9a-f]{12}(\+[0-9a-f]{8})?", content["commit"])
    assert {"processor", "cores", "instruction_set", "system", "python", "packages"} <= set(content["machine"])
    assert content["rows"]


def test_rows_are_kept_as_long_as_the_code_is_the_same(tmp_path: Path) -> None:
    def git(*arguments: str) -> None:
        who = "-c", "user.name=a", "-c", "user.email=a@b"
        subprocess.run(["git", *who, *arguments], cwd=tmp_path, check=True, capture_output=True)

    def printed(expression: str) -> str:
        script = f"import pathlib; from benchmarks import machine; machine.ROOT = pathlib.Path({str(tmp_path)!r})"
        command = [sys.executable, "-c", f"{script}; print({expression})"]
        return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()

    def written(name: str) -> str:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        with (tmp_path / name).open("a") as file:
            file.write("more")
        git("add", ".")
        return printed("machine.commit()")

    def committed(name: str) -> str:
        written(name)
        git("commit", "-m", name)
        return printed("machine.commit()")

    def same(*others: str) -> str:
        return printed(f"[machine.same_code({result!r}, other) for other in {others!r}]")

    git("init")
    code, text, result = (committed(name) for name in ("sgmethod/a.py", "README.md", "benchmarks/results/a.json"))
    assert same(result, code, text) == "[True, True, True]"
    changed = written("sgmethod/a.py")
    assert changed.startswith(f"{result}+")
    assert same(changed, committed("sgmethod/a.py"), "0123456789ab", "unknown") == "[False, False, False, False]"


def test_curves_of_every_method(tmp_path: Path) -> None:
    methods = ["rd", "paper", "plain Adam", "siren", "hash grid"]
    out = tmp_path / "convergence.json"
    sizes = ["--images", str(PHOTOGRAPHS), "--most", "1", "--megapixels", "0.002", "--bpp", "4", "--few"]
    times = ["--seconds", "0.4", "--limits", "0.3", "--paper-limits", "0.2", "--methods", ",".join(methods)]
    command = [sys.executable, "-m", "benchmarks.convergence", *sizes, *times, "--out", str(out)]
    subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, timeout=300)
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


def test_a_network_is_looked_at_on_some_of_its_pixels() -> None:
    script = (
        "from benchmarks import networks as n; network = n.hash_grid(n.np.zeros((10, 13, 3), n.np.uint8), 900); "
        "whole, some = n.drawn(network, (10, 13, 3)), n.drawn(network, (10, 13, 3), 3); "
        "print(some.shape, (whole[::3, ::3] == some).all())"
    )
    ran = subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=True, capture_output=True, text=True)
    assert ran.stdout == "(4, 5, 3) True\n"


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
    assert [first[0]["bits"][kind] for kind in ("colour", "shape", "place", "begin and end")] == [0, 0, 0, 0]
    assert run("flat,grey").startswith("scene grey")
    assert rows()[:1] == first
    grey = rows()[1]
    assert "chroma" in grey["left_out_of_the_file"]
    assert all(grey["bits"][kind] > 100 for kind in ("colour", "shape", "place"))
    assert 0 < grey["bits"]["begin and end"] < 100
    assert sum(grey["bits"].values()) == pytest.approx(8 * grey["bytes"], abs=2)  # each is rounded
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


def test_figures_that_do_not_come_out_again_are_named(tmp_path: Path) -> None:
    def run(module: str, *options: str) -> None:
        command = [sys.executable, "-m", f"benchmarks.{module}", *options]
        subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=300)

    needs, out = tmp_path / "needs.json", tmp_path / "again.json"
    run("needs", "--scenes", "flat,photograph", "--side", "32", "--repeats", "1", "--out", str(needs))
    content = json.loads(needs.read_text())
    content["rows"][1]["bytes"] += 1
    needs.write_text(json.dumps(content))
    run("again", "--images", ".", "--results", "needs", "--folder", str(tmp_path), "--out", str(out))
    (row,) = json.loads(out.read_text())["rows"]
    assert (row["of"], row["drawn"], row["made"]) == (2, 2, 2)
    assert row["different"] == [{"scene": "photograph", "by": {"bytes": 1}}]


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
    fitted = {"rows": [row_of("coin", "kodim13.png", 0.15, 0.149, 20.0)], "settings": {}}
    (results / "rd/fitted.json").write_text(json.dumps(content | fitted))
    ran = report(tmp_path)
    assert ran.returncode == 0, ran.stderr
    made = (tmp_path / "docs" / "results.md").read_text()
    assert re.search(r"^\| AV1 \(libaom\) \| [+-]0\.0 % \|", made, re.MULTILINE)
    assert not re.search(r"^\| GaussianImage \|.* % ", made, re.MULTILINE)  # its means are of one rate
    rd = "`rd`, tuned for PSNR"
    (line,) = re.findall(rf"^\| {rd} \|[^|]*\|[^|]*\|[^|]* % \| ([^|]*) \|[^|]*\|$", made, re.MULTILINE)
    assert line.endswith(" % (1)")  # kodim23 has no point so low
    assert f"| 0.15 | {rd} | 0.150 | 50.0 | 0.250 | 0.125 |" in made
    assert f"| {rd}, effort 9 | 0.15 | 1 | 0 | 1 | 0.1500 | 22.50 |" in made
    assert "| COIN | 0.15 | 1 | 0 | 1 | 0.1490 | 20.00 |" in made
    assert f"| {rd} | 0.15 | 1 | 0 | 1 | 0.1500 | 22.00 |" in made  # on that picture alone, beside it
    assert "| WebP, method 6 | 0.15 | 1 | 1 | 1 | 0.3000 | 22.00 |" in made  # and above what was allowed
    assert re.search(r"^\| WebP, method 6 \|.*\| \+[2-4]\d\.\d % \|$", made, re.MULTILINE)  # two files, not three


def run(module: str, out: Path, *arguments: str, check: bool = True) -> subprocess.CompletedProcess[str]:
    """Run a command of benchmarks."""
    command = [sys.executable, "-m", f"benchmarks.{module}", *arguments, "--out", str(out)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=check, timeout=300)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one picture of 64x48 pixels."""
    folder = tmp_path_factory.mktemp("small")
    with Image.open(PHOTOGRAPHS / "kodim05-crop.png") as picture:
        picture.crop((0, 0, 64, 48)).save(folder / "small.png")
    return folder


def test_representations_are_measured(tmp_path: Path, small: Path) -> None:
    out = tmp_path / "representation.json"
    sizes = ["--images", str(small), "--gaussians", "60", "--steps", "60"]
    refused = run("representation", out, *sizes, "--methods", "siren", check=False)
    assert "measure rd first" in refused.stderr
    methods = ["rd", "paper", "random-start", "wire"]
    run("representation", out, *sizes, "--methods", ",".join(methods[:3]))
    kept = json.loads(out.read_text())["rows"]
    printed = run("representation", out, *sizes, "--methods", ",".join(methods)).stdout
    rows = json.loads(out.read_text())["rows"]
    assert rows[:3] == kept
    assert [row["method"] for row in rows] == methods
    rd, paper, random, wire = rows
    assert wire["seconds"] >= rd["seconds"]
    assert (paper["gaussians"], paper["thousand_numbers"], wire["gaussians"]) == (60, 0.48, None)
    assert wire["thousand_numbers"] <= 0.48
    assert min(rd["psnr"], paper["psnr"]) > max(random["psnr"], wire["psnr"]) > 10
    for row in rows:
        assert min(row["frames_per_s"], row["mib"]) > 1
    assert "| 60 | WIRE | 1 | " in printed


def test_ablations_are_measured(tmp_path: Path, small: Path) -> None:
    out = tmp_path / "ablation.json"
    options = ["--images", str(small), "--seeds", "2", "--fit-steps", "30", "--tune-steps", "10"]
    printed = run("ablation", out, *options, "--tables", "regularisation,quantisation").stdout
    rows = json.loads(out.read_text())["rows"]
    assert len(rows) == 2 * (5 + 3 * 7)
    of = {(row["setting"], row["asked"], row["seed"]): row for row in rows}
    assert of["0", 70_000, 0]["gaussians"] == 137  # 70,000 of 768x512 pixels, for 32x24
    assert of["0", 70_000, 0]["psnr"] != of["0", 70_000, 1]["psnr"] != of["0.08", 70_000, 1]["psnr"]
    assert of["LSQ, 8 bits", 7000, 0]["bpp"] > of["LSQ, 6 bits", 7000, 0]["bpp"]
    assert of["LSQ, 7 bits", 7000, 0]["bits_of_factor"] == 7
    assert 6 < of["ABQ, weight 0.0012", 7000, 0]["bits_of_factor"] < 16
    assert printed.count("1 picture, 2 seeds.") == 2
    assert "| LSQ, 6 bits | " in printed


def test_every_part_that_is_left_out_is_missed(tmp_path: Path) -> None:
    """A part's file differs from that with all parts: what is patched is what is used."""
    out = tmp_path / "ablation.json"
    run(
        "ablation",
        out,
        *["--images", str(PHOTOGRAPHS), "--most", "1", "--tables", "parts", "--seeds", "1", "--bpp", "2"],
    )
    whole, *without = json.loads(out.read_text())["rows"]
    assert whole["without"] == "nothing"
    for row in without:
        assert (row["psnr"], row["gaussians"]) != (whole["psnr"], whole["gaussians"]), row["without"]


def shown_by_report(folder: Path, name: str, rows: list[dict[str, Any]], settings: dict[str, Any]) -> str:
    """docs/results.md with these rows in one JSON."""
    path = copied(folder) / f"{name}.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "rows": rows, "settings": settings}))
    assert report(folder).stderr == ""
    return (folder / "docs" / "results.md").read_text()


def test_an_ablation_says_what_seeds_leave_open_and_where_the_paper_differs(tmp_path: Path) -> None:
    """Each weight twice, with seeds that differ by 0.2 dB: a spread of 0.14."""
    means = {"0": 41.0, "0.04": 40.0, "0.06": 40.1, "0.08": 39.9}
    key = {"table": "regularisation", "asked": 70_000, "image": "a.png"}
    figures = {"gaussians": 1, "ms_ssim": None, "seconds": 1.0}
    rows = [
        {**key, "setting": setting, "seed": seed, **figures, "psnr": mean + 0.2 * seed}
        for setting, mean in means.items()
        for seed in (0, 1)
    ]
    rows.append({**rows[0], "image": "b.png"})  # a picture that is not complete
    text = shown_by_report(tmp_path, "ablation", rows, {"bpp": 0.25})
    assert "1 picture, 2 seeds; 1 more not yet complete." in text
    assert "| 0.04 | 40.10 | 0.141 | -1.00 | - | 1.0 |" in text
    assert "| 0.06 | 40.20 | 0.141 | +0.10 (within the spread) | - | 1.0 |" in text
    assert (
        "our order differs: the paper has 0.04 ahead of 0, here 0 is ahead by 1.00 dB. "
        "Too near to tell, by seeds or rounding: 0.08 against 0.04." in text
    )


def test_rates_of_an_ablation_are_against_its_anchor(tmp_path: Path) -> None:
    """The same PSNR for nine tenths of the bits is -10 %."""
    rows = [
        {"table": "positions", "setting": setting, "asked": n, "image": "a.png", "seed": 0, "bpp": part * n, "psnr": db}
        for setting, part in (("16", 1.0), ("12", 0.9))
        for n, db in ((1, 30.0), (2, 33.0), (4, 36.0))
    ]
    text = shown_by_report(tmp_path, "ablation", rows, {"bpp": 0.25})
    # 3 dB for twice the bits: 0.9 of them are log2(1 / 0.9) = 0.152 of that
    assert "| 12 | +0.46 | - |  | -10.0 | - | 33.00 | 2.1000 | - |" in text


def test_representations_are_compared_over_the_pictures_that_all_have(tmp_path: Path) -> None:
    key = {"asked": 70_000, "ms_ssim": 0.9, "seconds": 1.0}
    rows = [
        {**key, "image": "a.png", "psnr": 40.0},  # as rows were before there were methods
        {**key, "image": "b.png", "psnr": 50.0},
        {**key, "image": "a.png", "psnr": 39.0, "method": "paper", "mib": 300.0},
        {**key, "image": "a.png", "psnr": 39.5, "method": "baseline"},
    ]
    text = shown_by_report(tmp_path, "representation", rows, {"steps": 10})
    assert "| 70,000 | `rd` | 1 | 40.00 | 0.9000 | - | 1.0 | - | - | - |" in text
    assert "| 70,000 | `paper` | 1 | 39.00 | 0.9000 | - | 1.0 | - | 300 | - |" in text
    assert "our order differs: the paper has the paper ahead of GSImage, here GSImage is ahead by 0.50 dB." in text
    assert "| both, 70,000 Gaussians | +1.32 dB | -0.50 dB | - | the other way round |" in text


@pytest.mark.parametrize(
    ("db", "verdict"),
    [(0.25, "yes"), (0.24, "in part"), (0.03, "nothing that can be told"), (-0.2, "the other way round")],
)
def test_a_claim_of_the_paper_has_a_verdict(tmp_path: Path, db: float, verdict: str) -> None:
    """The paper's regularisation is worth 0.49 dB with 30,000 Gaussians."""
    key = {"asked": 30_000, "ms_ssim": 0.9, "seconds": 1.0, "image": "a.png"}
    methods = {"paper": 38 + db, "unregularised": 38.0}
    rows = [{**key, "method": method, "psnr": level} for method, level in methods.items()]
    text = shown_by_report(tmp_path, "representation", rows, {"steps": 10})
    assert f"| regularisation, 30,000 Gaussians | +0.49 dB | {db:+.2f} dB | - | {verdict} |" in text
