"""The command benchmarks.robustness stiff: its pictures, its rules on rows that are made up, and one tiny run."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sgmethod.io.image import read_image
from tests.harness.data import ROOT

pytestmark = pytest.mark.thorough

SIZES = {"row-300x1": (1, 300), "column-1x300": (300, 1), "pixel-1x1": (1, 1), "strip-4096x16": (16, 4096)}
ANGLES = (0, 10, 30, 45)
NAMES = {
    *(f"lines-{angle}-on-{ground}" for angle in ANGLES for ground in ("white", "black")),
    *("chart", "text", "screenshot", "zone-plate", "impulses", "steps-and-ramps", "noise", "grey", "primaries"),
    *("checkerboard-1", "checkerboard-2", "checkerboard-3", "columns-red-blue", "columns-black-white"),
    *SIZES,
}


def stiff(*arguments: object) -> str:
    """What the command prints."""
    command = [sys.executable, "-m", "benchmarks.robustness", "stiff", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, timeout=600).stdout


# Pictures


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    stiff("--draw", folder)
    return folder


@pytest.fixture(scope="module")
def pictures(drawn: Path) -> dict[str, NDArray[np.uint8]]:
    def pixels(path: Path) -> NDArray[np.uint8]:
        return np.round(read_image(path.read_bytes()) * 255).astype(np.uint8)

    return {path.stem: pixels(path) for path in drawn.glob("*.png")}


def test_every_picture_has_its_size(pictures: dict[str, NDArray[np.uint8]]) -> None:
    assert {name: picture.shape for name, picture in pictures.items()} == {
        name: (*SIZES.get(name, (256, 256)), 3) for name in NAMES
    }


def test_pictures_are_the_same_at_every_call(drawn: Path, tmp_path: Path) -> None:
    stiff("--draw", tmp_path)
    assert digests(tmp_path) == digests(drawn)
    assert len(set(digests(drawn).values())) == len(NAMES)


def digests(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.glob("*.png")}


@pytest.mark.parametrize("angle", ANGLES)
def test_lines_are_one_pixel_wide(pictures: dict[str, NDArray[np.uint8]], angle: int) -> None:
    white, black = (pictures[f"lines-{angle}-on-{ground}"] for ground in ("white", "black"))
    assert (white == 255 - black).all()
    assert np.median(black) == 0
    # One pixel in every 32 across the lines. Seen: up to 1.9 % more, where a corner has a line of its own.
    assert black.mean() == pytest.approx(255 / 32, rel=0.03)


@pytest.mark.parametrize("cell", [1, 2, 3])
def test_checkerboards(pictures: dict[str, NDArray[np.uint8]], cell: int) -> None:
    board = pictures[f"checkerboard-{cell}"]
    assert set(np.unique(board)) == {0, 255}
    assert (board[:, cell:] == 255 - board[:, :-cell]).all()
    assert (board[cell:] == 255 - board[:-cell]).all()


def test_columns_take_turns(pictures: dict[str, NDArray[np.uint8]]) -> None:
    for name, left, right in (("red-blue", (255, 0, 0), (0, 0, 255)), ("black-white", (0, 0, 0), (255, 255, 255))):
        picture = pictures[f"columns-{name}"]
        assert (picture[:, 0::2] == left).all()
        assert (picture[:, 1::2] == right).all()


def test_colours(pictures: dict[str, NDArray[np.uint8]]) -> None:
    colours = {name: np.unique(picture.reshape(-1, 3), axis=0) for name, picture in pictures.items()}
    assert colours["primaries"].tolist() == [
        *([0, 0, 255], [0, 255, 0], [0, 255, 255]),
        *([255, 0, 0], [255, 0, 255], [255, 255, 0]),
    ]
    assert set(np.unique(colours["impulses"])) == {0, 255}
    assert pictures["impulses"].any(axis=2).sum() == 48
    for name in ("grey", "zone-plate", "steps-and-ramps"):
        assert (np.ptp(colours[name], axis=1) == 0).all()
        assert len(colours[name]) > 150
    assert pictures["noise"].mean() == pytest.approx(127.5, abs=0.7)  # seen: 0.37
    assert (pictures["column-1x300"] == pictures["row-300x1"].transpose(1, 0, 2)).all()
    assert len(np.unique(pictures["strip-4096x16"][0, :, 0])) > 200


@pytest.mark.parametrize("name", ["chart", "text", "screenshot"])
def test_drawings_have_letters(pictures: dict[str, NDArray[np.uint8]], name: str) -> None:
    """Dark pixels, and levels between dark and light beside them."""
    levels = pictures[name].mean(axis=2)
    assert (levels < 64).mean() > 0.005
    assert len(np.unique(levels)) > 30


# Rules


def row(kind: str, value: float, size: int | None, psnr: float | None, **others: Any) -> dict[str, Any]:
    """A row of 65,536 pixels, so that 0.001 bpp are 8 bytes."""
    most = int(value * 8192) if kind == "bpp" else None
    return {"seed": 0, "kind": kind, "value": value, "bytes": size, "psnr": psnr, "max_bytes": most, **others}


# Rows of one picture, and how far each rule is broken by them.
CASES: dict[str, tuple[list[dict[str, Any]], list[tuple[str, float]]]] = {
    "all kept": (
        [
            *(row("bpp", 1, 8100, 30.0), row("bpp", 2, 16384, 33.0), row("bpp", 4, 32000, None)),
            *(row("psnr", 30, 8200, 30.05), row("psnr", 40, 31500, 40.0)),
            *(row("quality", 10, 500, 20.0), row("quality", 20, 500, 20.0), row("quality", 30, 8190, 29.95)),
        ],
        [],
    ),
    "failed": ([row("quality", 10, None, None, error="MemoryError: none left")], [("failed", 1)]),
    "refused": ([row("bpp", 0.001, None, None, refused="BudgetError: 8 bytes"), row("quality", 10, 20, 30.0)], []),
    "refused, but it would do": (
        [row("bpp", 0.001, None, None, refused="BudgetError: 8 bytes"), row("quality", 10, 8, 30.0)],
        [("failed", 1)],
    ),
    "falls": (
        [row("bpp", 1, 8192, 30.0), row("bpp", 2, 16384, 29.5), row("bpp", 4, 32768, 29.4)],
        [("falls", 0.6)],
    ),
    "falls, but not where bytes grow": ([row("bpp", 1, 8000, 30.0), row("bpp", 1.001, 8000, 29.0)], []),
    "falls, but both are exact": ([row("bpp", 1, 8192, None), row("bpp", 2, 16384, 59.0)], []),
    "falls from exact": ([row("bpp", 1, 8192, None), row("bpp", 2, 16384, 40.0)], [("falls", 18.9)]),
    "exceeded": ([row("bpp", 1, 8193, 30.0), row("bpp", 2, 16384, 30.0)], [("exceeded", 1)]),
    "missed": ([row("psnr", 30, 900, 29.9), row("bpp", 1, 8192, 30.0)], [("missed", 0.1)]),
    "missed, but so do all": ([row("psnr", 30, 900, 29.9), row("bpp", 1, 8192, 29.9)], []),
    "clipped": ([row("quality", 10, 900, 30.0, clipped=3)], [("clipped", 3)]),
    "trace": ([row("quality", 10, 900, 30.0, traced=[890, 30.3, "joint"])], [("trace", 0.3)]),
    "trace, but little": ([row("quality", 10, 900, 30.0, traced=[890, 30.05, "joint"])], []),
    "trace, but it has what was asked for": ([row("psnr", 30, 900, 30.05, traced=[890, 31.0, "joint"])], []),
    "trace, and it misses what was asked for": (
        [row("psnr", 30, 900, 29.9, traced=[890, 31.0, "joint"])],
        [("trace", 1.1)],
    ),
    "trace, but exact": ([row("quality", 10, 900, 59.0, traced=[890, 70.0, "joint"])], []),
}


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The JSON after all cases were judged, each as a picture of its own; seed 1 is a picture apart."""
    rows = [{**made_up, "picture": name} for name, (group, _) in CASES.items() for made_up in group]
    rows += [{**row("bpp", 2, 16384, 10.0), "picture": "falls", "seed": 1}]
    path = tmp_path_factory.mktemp("judged") / "rows.json"
    machine = {"processor": "abacus", "cores": 1, "instruction_set": "none"}
    path.write_text(json.dumps({"commit": "0", "date": "today", "machine": machine, "rows": rows}))
    stiff("--judge", "--out", path)
    return path


@pytest.mark.parametrize("case", CASES)
def test_rules(judged: Path, case: str) -> None:
    found = [v for v in json.loads(judged.read_text())["violations"] if v["picture"] == case]
    assert [(v["rule"], v["by"]) for v in found] == [(rule, pytest.approx(by, abs=1e-4)) for rule, by in CASES[case][1]]


def test_the_report_counts(judged: Path) -> None:
    content = json.loads(judged.read_text())
    counts = {line["rule"]: line for line in content["rules"]}
    assert set(counts) == {rule for _, broken in CASES.values() for rule, _ in broken}
    assert counts["falls"]["broken"] == 2
    assert counts["falls"]["worst"] == {
        "rule": "falls",
        "by": 18.9,
        "picture": "falls from exact",
        "seed": 0,
        "kind": "bpp",
        "value": 2,
    }
    assert counts["clipped"]["checked"] == len([r for r in content["rows"] if r["bytes"] is not None])
    assert sum(line["broken"] for line in counts.values()) == len(content["violations"])
    report = stiff("--judge", "--out", judged)
    sizes = sum(r["kind"] == "bpp" and r["bytes"] is not None for r in content["rows"])
    assert f"| exceeded | 0 bytes | {sizes} | 1 | 1: exceeded, seed 0, bpp 1 |" in report
    assert "| refused | 2 | 1 | 0 | - |" in report
    assert "| falls | 4 | 0 | 1 | falls 1 |" in report
    assert "abacus" in report


# Runs


def test_a_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    path = tmp_path / "rows.json"
    run = ("--pictures", "pixel-1x1,row-300x1", "--seeds", 1, "--out", path)
    first = stiff(*run, "--only", "bpp")
    rows = json.loads(path.read_text())["rows"]
    assert [row["value"] for row in rows] == 2 * [0.1, 0.3, 1, 2, 4, 8]
    assert all(f"{row['picture']}, seed 0, bpp {row['value']:g}: " in first for row in rows)
    for made in rows:
        assert (made["bytes"] is None) == (made["max_bytes"] < 18), made  # the smallest file
        assert (made["refused"] is None) == (made["bytes"] is not None)
        assert made["error"] is None
        assert made["clipped"] == 0
        if made["bytes"] is not None:
            size, psnr, _ = made["traced"]
            assert size <= made["bytes"] <= made["max_bytes"]
            assert psnr >= made["psnr"] - 1e-4  # the last point of the trace is the file itself
    second = stiff(*run, "--only", "bpp,psnr")
    assert "bpp 8:" not in second
    assert "psnr 40:" in second
    assert json.loads(path.read_text())["rows"][: len(rows)] == rows
    assert f"| {rows[0]['picture']} | " in second


def test_a_name_that_there_is_not_is_refused(tmp_path: Path) -> None:
    names = ("--pictures=text,x", "--only=bpp,bytes")
    for arguments, words in ((names, "bytes, x: no such name"), (("--judge",), "there are no rows")):
        with pytest.raises(subprocess.CalledProcessError) as refused:
            stiff("--out", tmp_path / "none.json", *arguments)
        assert refused.value.returncode == 2
        assert words in refused.value.stderr
