"""sgmethod preview: what it prints for one picture and for several, and the folder it writes."""

from __future__ import annotations

import argparse
import io
import json
from pathlib import Path

import pytest

import sgmethod
from sgmethod.cli.naming import Conversion
from sgmethod.cli.previewing import _print_in_turn
from sgmethod.many.run import Tally
from tests.cli.conftest import PHOTO, Run, assert_refused

FIELDS = ["text", "width", "height", "color", "dark"]


@pytest.fixture
def pictures() -> None:
    Path("photos").mkdir()
    for number in (1, 2):
        PHOTO.rotate(number).save(f"photos/{number} a.png")
    Path("photos/broken.jpg").write_bytes(b"\xff\xd8\xff")


def test_one_text(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    ran = run("preview", "photo.png", "--bytes", "0.1k")
    assert (ran.status, ran.err) == (0, "")
    assert len(sgmethod.from_text(ran.out.strip())) <= 100
    again = run("preview", "photo.png", "--bytes", "100", "--json")
    assert list(json.loads(again.out)) == FIELDS
    assert json.loads(again.out)["text"] == ran.out.strip()
    Path("text").write_text(ran.out)
    assert run("decode", "text", "out.png").status == 0
    assert "version 2" in run("info", "text").out
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(Path("photo.png").read_bytes())))
    assert run("preview", "-", "--bytes", "100").out == ran.out


@pytest.mark.usefixtures("pictures")
@pytest.mark.parametrize(("option", "tag"), [("--html", "<img "), ("--element", "<sg-img preview=")])
def test_html(run: Run, option: str, tag: str) -> None:
    ran = run("preview", "photos/1 a.png", "photo.png", option, "--bytes", "60")
    first, second = ran.out.splitlines()
    assert first.startswith(tag)
    assert '<img src="photos/1%20a.png" alt="" width="128" height="96"' in first
    assert '<img src="photo.png"' in second
    assert 'alt="A &lt;door&gt;"' in run("preview", "photo.png", option, "--bytes", "60", "--alt", "A <door>").out


@pytest.mark.usefixtures("pictures")
def test_several(run: Run) -> None:
    ran = run("preview", "photos", "--bytes", "60")
    assert ran.status == 1
    assert [line.split("\t")[0] for line in ran.out.splitlines()] == ["photos/1 a.png", "photos/2 a.png"]
    assert ran.err.startswith("sgmethod: photos/broken.jpg: ")
    lines = [json.loads(line) for line in run("preview", "photos", "--bytes", "60", "--json").out.splitlines()]
    assert [list(line) for line in lines] == [["input", *FIELDS]] * 2
    assert [line["text"] for line in lines] == [line.split("\t")[1] for line in ran.out.splitlines()]


def test_the_order_is_that_of_the_arguments(capsys: pytest.CaptureFixture[str]) -> None:
    """Whichever process is done first."""
    arguments = argparse.Namespace(quiet=False, json=False, html=False, element=False)
    names, done = ["a", "b", "a"], dict[str, list[Conversion]]()
    for name in ("b", "a", "a"):
        outcome = Conversion(name, name, summary="text", error="bad" if name == "b" else None)
        _print_in_turn(arguments, names, done, outcome, Tally())
    output = capsys.readouterr()
    assert (output.out, output.err) == ("a\ttext\na\ttext\n", "sgmethod: b: bad\n")
    assert names == []


@pytest.mark.usefixtures("pictures")
def test_a_folder_and_its_manifest(run: Run) -> None:
    arguments = ("preview", "photos", "--output-dir", "out", "--resume", "--bytes", "60")
    ran = run(*arguments)
    assert ran.status == 1
    rows = {row["name"]: row for row in map(json.loads, Path("out/manifest.jsonl").read_text().splitlines())}
    assert sorted(rows) == ["1 a.sg", "2 a.sg", "broken.sg"]
    assert list(rows["1 a.sg"]["figures"]) == FIELDS
    assert sgmethod.from_text(rows["1 a.sg"]["figures"]["text"]) == Path("out/1 a.sg").read_bytes()
    assert "0 made, 2 skipped, 1 failed" in run(*arguments).out
    assert "2 made, 0 skipped, 1 failed" in run(*arguments, "--bytes", "61").out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("photo.png --bytes 5 --output-dir out", "from 12 to 16384, got 5"),
        ("photo.png --bytes 20k --output-dir out", "from 12 to 16384, got 20000"),
        ("photo.png --resume", "--resume needs --output-dir"),
        ("photo.png --html --json", "not allowed with"),
        ("- --html", "cannot be combined with - or --output-dir"),
        ("photo.png --element --output-dir out", "cannot be combined with - or --output-dir"),
        ("photo.png --alt door", "--alt needs --html or --element"),
        ("photo.png photo.png --html --alt door", "--alt describes one picture, and 2 were given"),
        ("picture.sg", "an .sg file already"),
    ],
)
def test_refusals(run: Run, arguments: str, message: str) -> None:
    assert_refused(run("preview", *arguments.split()), message)
