"""Documents against the JSON of benchmarks/results, the form of each JSON, and rows that are kept or made again."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.benchmarks.commands import RESULTS, copied, report, run
from tests.harness.data import ROOT

JSONS = sorted(RESULTS.rglob("*.json"))


def test_documents_are_what_the_json_says() -> None:
    ran = report(ROOT, "--check")
    assert (ran.returncode, ran.stderr) == (0, "")


def spoil_times(content: Any) -> None:
    """The means stay, the ratios of two pictures do not."""
    one, other, *_ = (row for row in content["rows"] if (row["codec"], row["max_bpp"]) == ("jpeg", 0.25))
    one["decode_ms"], other["decode_ms"] = other["decode_ms"] + 10, one["decode_ms"] - 10


def spoil_origin(content: Any) -> None:
    content["commit"] = "0123456789ab"


@pytest.mark.parametrize(
    ("name", "spoil", "documents"),
    [
        ("rd/kodak", spoil_times, "README.md"),
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


def test_a_broken_rule_of_the_stiff_set_is_told_in_the_readme(tmp_path: Path) -> None:
    path = copied(tmp_path) / "version4" / "stiff.json"
    content = json.loads(path.read_text())
    for rule in content["rules"]:
        rule["broken"] = 0
    (rule,) = (rule for rule in content["rules"] if rule["rule"] == "falls")
    rule |= {"checked": 438, "broken": 3, "worst": {"by": 5.75, "picture": "text", "kind": "bpp", "value": 4}}
    path.write_text(json.dumps(content))
    assert report(tmp_path).stderr == ""
    readme = " ".join((tmp_path / "README.md").read_text().split())
    assert "1 of 6 rules of the [stiff set](docs/results.md#stiff-and-extreme-cases) are broken there: -" in readme
    assert '"A file is no worse than one of fewer bytes": by 3 of 438 files, by 5.8 dB at most (text).' in readme
    assert "| 5.75 (text, bpp 4) | broken 3 times |" in (tmp_path / "docs" / "results.md").read_text()


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
    (tmp_path / "service").mkdir()
    (tmp_path / "service" / "new.py").write_text("not added yet")
    assert printed("machine.commit()") not in (result, changed)
    (tmp_path / "service" / "new.py").unlink()
    assert printed("machine.same_code('unknown', 'unknown')") == "False"
    assert same(changed, committed("sgmethod/a.py"), "0123456789ab", "unknown") == "[False, False, False, False]"


def test_a_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    def measured(scenes: str, side: str = "32") -> str:
        return run("needs", tmp_path / "needs.json", "--scenes", scenes, "--side", side, "--repeats", "1").stdout

    def rows() -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = json.loads((tmp_path / "needs.json").read_text())["rows"]
        return found

    measured("flat")
    first = rows()
    assert first[0]["left_out_of_the_file"] == ["Gaussians"]
    assert [first[0]["bits"][kind] for kind in ("colour", "shape", "place", "begin and end")] == [0, 0, 0, 0]
    assert measured("flat,grey").startswith("scene grey")
    assert rows()[:1] == first
    grey = rows()[1]
    assert "chroma" in grey["left_out_of_the_file"]
    assert 12 < first[0]["lossless_bytes"] < 100 < grey["bytes"] < grey["lossless_bytes"] < 32 * 32
    assert all(grey["bits"][kind] > 100 for kind in ("colour", "shape", "place"))
    assert 0 < grey["bits"]["begin and end"] < 100
    assert sum(grey["bits"].values()) == pytest.approx(8 * grey["bytes"], abs=2)  # each is rounded
    assert sum(grey["steps_by_spacing"].values()) == grey["steps"] > 100
    assert grey["steps_by_spacing"]["2"] > 10
    measured("flat", side="33")  # another setting, another run
    assert [row["scene"] for row in rows()] == ["flat"]


def test_figures_that_do_not_come_out_again_are_named(tmp_path: Path) -> None:
    needs, out = tmp_path / "needs.json", tmp_path / "again.json"
    run("needs", needs, "--scenes", "flat,photograph", "--side", "32", "--repeats", "1")
    content = json.loads(needs.read_text())
    content["rows"][1]["bytes"] += 1
    needs.write_text(json.dumps(content))
    options = ["--images", ".", "--results", "needs", "--folder", str(tmp_path)]
    said = run("again", out, *options).stdout
    (row,) = json.loads(out.read_text())["rows"]
    assert (row["of"], row["drawn"], row["made"]) == (2, 2, 2)
    was = content["rows"][1]["bytes"]
    assert row["different"] == [{"scene": "photograph", "figures": {"bytes": [was, was - 1]}}]
    assert f"1 came out with other bytes or another figure (needs: photograph, bytes {was} then, {was - 1} now)" in said
    for changed, said in (
        ({"command": "python -m benchmarks.needs --scenes nothing"}, "failed with status 2"),
        ({"settings": {"quality": 51, "side": 32}}, "other settings"),
    ):
        needs.write_text(json.dumps(content | changed))
        out.unlink(missing_ok=True)
        failed = run("again", out, *options, check=False)
        assert failed.returncode == 1
        assert said in failed.stderr
        assert ("nothing: no such scene" in failed.stderr) == ("command" in changed)
        assert not out.exists()


def test_a_command_is_typed_again_with_the_folders_of_this_machine() -> None:
    typed = "SG_THREADS=1 python -m benchmarks.rd --images KODAK --profiles '' --weights WEIGHTS --bpp 0.1"
    script = (
        "from pathlib import Path; from benchmarks.again.__main__ import arguments; "
        f"print(arguments({typed!r}, Path('/a'), Path('/b')), arguments({typed!r}, Path('/a'), None))"
    )
    ran = subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=True, capture_output=True, text=True)
    begin, end = ["benchmarks.rd", "--images", "/a", "--profiles", ""], ["--bpp", "0.1"]
    threads = {"SG_THREADS": "1"}
    assert ran.stdout == f"{([*begin, '--weights', '/b', *end], threads)} {([*begin, *end], threads)}\n"
