"""sgmethod plot: traces become pictures, and what is no trace is refused."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sgmethod.cli import main as cli

POINT = {"seconds": 0.5, "step": 1, "steps": 2, "psnr": 20.0, "bytes": 0, "gaussians": 9, "phase": "joint"}
END = {**POINT, "seconds": 1.5, "psnr": 30.0, "bytes": 1234, "phase": "done"}


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("fit.json").write_text(json.dumps({"stats": {}, "trace": [POINT, {**POINT, "phase": "tune"}, END]}))


@pytest.mark.parametrize(("name", "begins"), [("fit.svg", b"<?xml"), ("fit.png", b"\x89PNG"), ("fit.pdf", b"%PDF")])
def test_a_trace_becomes_a_picture(name: str, begins: bytes, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["plot", "fit.json", name]) == 0
    assert Path(name).read_bytes().startswith(begins)
    assert capsys.readouterr() == (f"fit.json -> {name}: 3 points, 1.5 s\n", "")


def test_a_plot_shows_the_trace_without_colour() -> None:
    assert cli.main(["plot", "fit.json", "fit.svg", "--quiet"]) == 0
    text = Path("fit.svg").read_text()
    for words in ("joint", "tune", "the file: 30.00 dB, 1,234 bytes", "seconds", "PSNR, dB"):
        assert f"<!-- {words} -->" in text
    assert cli.main(["plot", "fit.json", "fit.png", "--quiet"]) == 0
    assert int(np.ptp(np.asarray(Image.open("fit.png").convert("RGB")), axis=2).max()) == 0
    assert cli.main(["plot", "fit.json", "again.svg", "--quiet"]) == 0
    assert Path("again.svg").read_text() == text
    Path("one.json").write_text(json.dumps({"trace": [END]}))
    assert cli.main(["plot", "one.json", "one.svg", "--quiet"]) == 0


@pytest.mark.parametrize(
    "content",
    [
        *("", "[]", "{}", "x", "[" * 100_000, '{"trace": []}', '{"trace": [{}]}', '{"trace": 1}'),
        *(
            json.dumps({"trace": [{**POINT, field: None}]})
            for field in ("seconds", "psnr", "bytes", "gaussians", "phase")
        ),
        json.dumps({"trace": [{**POINT, "psnr": float("nan")}]}),
    ],
    ids=lambda content: content[:40],
)
def test_what_is_no_trace_is_refused(content: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("bad.json").write_text(content)
    assert cli.main(["plot", "bad.json", "out.svg"]) == 2
    assert capsys.readouterr() == ("", "sgmethod: bad.json is not a trace: write one with encode --trace\n")
    assert not Path("out.svg").exists()


def test_names_that_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["plot", "fit.json", "fit.gif"]) == 2
    assert "must end in one of .svg, .png, .pdf" in capsys.readouterr().err
    assert cli.main(["plot", "fit.json", "fit.json"]) == 2
    assert not capsys.readouterr().out


def test_without_matplotlib(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert cli.main(["plot", "fit.json", "fit.svg"]) == 2
    assert "pip install 'sgmethod[plot]'" in capsys.readouterr().err


def test_a_backend_that_is_none() -> None:
    """The window system of the user is not asked for, but Matplotlib checks its name."""
    command = [sys.executable, "-m", "sgmethod", "plot", "fit.json", "fit.svg"]
    environment = {**os.environ, "MPLBACKEND": "none"}
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert ran.returncode == 2
    assert re.fullmatch(r"sgmethod: MPLBACKEND is not a backend of Matplotlib: .*\n", ran.stderr)
