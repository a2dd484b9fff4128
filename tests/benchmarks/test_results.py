"""Documents against the JSON of benchmarks/results, the form of each JSON, and rows that are kept or made again."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmarks.commands import RESULTS, copied, report
from tests.harness.data import ROOT

JSONS = sorted(RESULTS.rglob("*.json"))


def test_documents_are_what_the_json_says() -> None:
    ran = report(ROOT, "--check")
    assert (ran.returncode, ran.stderr) == (0, "")


@pytest.mark.parametrize(
    ("name", "documents"), [("rd/kodak", {"rate.md", "README.md", "kodak.csv"}), ("ablation", {"paper.md"})]
)
def test_a_document_that_differs_is_named(tmp_path: Path, name: str, documents: set[str]) -> None:
    path = copied(tmp_path) / f"{name}.json"
    content = json.loads(path.read_text())
    content["commit"] = "0123456789ab"
    for row in content["rows"]:
        row["psnr"] += 1
    path.write_text(json.dumps(content))
    ran = report(tmp_path, "--check")
    assert ran.returncode == 1
    named, _, said = ran.stderr.partition(": ")
    assert said.startswith("not what the JSON says")
    assert documents <= {Path(name).name for name in named.split(", ")}


def test_no_command_imports_the_report() -> None:
    """The report knows the commands, and they do not know it."""
    for path in (ROOT / "benchmarks").rglob("*.py"):
        if path.parent.name != "report":
            assert re.search(r"^\s*(from|import) benchmarks\.report", path.read_text(), re.MULTILINE) is None, path


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
