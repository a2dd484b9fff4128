"""Documents against the JSON of benchmarks/results, and the form of each JSON."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.machine import one_a_line, rows_of
from benchmarks.report import __main__ as report
from benchmarks.report.__main__ import filled, stale
from tests.support.data import ROOT

RESULTS = ROOT / "benchmarks" / "results"
JSONS = sorted(RESULTS.rglob("*.json"))


def test_documents_are_what_the_json_says() -> None:
    command = [sys.executable, "-m", "benchmarks.report", "--check"]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=100)
    assert (ran.returncode, ran.stderr) == (0, "")


@pytest.mark.parametrize(
    ("sentence", "error"),
    [
        ("It saves 13.9<!-- rate.fewer-than-avif --> % of the bits.", []),
        ("It saves (14<!-- rate.fewer-than-avif --> % of the bits).", []),
        (
            "It saves 14.9<!-- rate.fewer-than-avif --> % of the bits.",
            ["14.9 (rate.fewer-than-avif): the JSON has 13.92"],
        ),
        (
            "It saves 14.9<!--\nrate.fewer-than-avif --> % of the bits.",
            ["14.9 (rate.fewer-than-avif): the JSON has 13.92"],
        ),
        ("It saves 13.9 %<!-- rate.fewer-than-avif --> of the bits.", ["% (rate.fewer-than-avif): no number"]),
        ("It saves 13.9<!-- rate.avif --> % of the bits.", ["13.9 (rate.avif): no such figure"]),
    ],
)
def test_figures_of_sentences_are_compared(sentence: str, error: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "figures", lambda: {"rate.fewer-than-avif": 13.92})
    assert list(stale(sentence)) == error


def test_tables_are_filled() -> None:
    page = "A\n<!-- table rate -->\n| old |\n<!-- end -->\nB"
    assert filled(page).startswith("A\n<!-- table rate -->\n| codec")
    assert filled(page).endswith(" |\n<!-- end -->\nB")
    with pytest.raises(KeyError):
        filled(page.replace("rate", "unknown"))


@pytest.mark.parametrize("path", JSONS, ids=lambda path: str(path.relative_to(RESULTS)))
def test_results_say_where_they_come_from(path: Path) -> None:
    content = json.loads(path.read_text())
    assert {"command", "commit", "date", "machine", "settings", "rows"} <= set(content)
    words = [word for word in content["command"].split() if not (RESULTS / f"{word}.json").exists()]
    assert re.fullmatch(r"(SG_THREADS=\d+ )?python -m benchmarks\.\w+[^/]*", " ".join(words))  # no path of a machine
    assert re.fullmatch(r"[0-9a-f]{12}(\+[0-9a-f]{8})?", content["commit"])
    assert {"processor", "cores", "instruction_set", "system", "python", "packages"} <= set(content["machine"])
    assert rows_of(content)


def test_rows_come_back_from_their_columns() -> None:
    rows = [{"codec": "a", "psnr": 1.5}, {"codec": "b", "times": [1, 2]}, {"codec": "c", "psnr": None}]
    text = one_a_line({"settings": {}, "rows": rows})
    assert rows_of(json.loads(text)) == rows
    assert text.splitlines()[2:] == [
        '"rows": [',
        '{"at": [0, 2],',
        ' "codec": ["a", "c"],',
        ' "psnr": [1.5, null]},',
        '{"at": [1],',
        ' "codec": ["b"],',
        ' "times": [[1, 2]]}',
        "]",
        "}",
    ]
