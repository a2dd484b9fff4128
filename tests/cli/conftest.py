"""The command line in this process and in one of its own, in a folder with a photograph and a file."""

from __future__ import annotations

import os
import pty
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from PIL import Image

from sgmethod.cli import main as cli
from tests.support.data import golden_path
from tests.support.pictures import photo
from tests.support.profiles import shorten

PHOTO = Image.fromarray(photo())  # 128 x 96


class Ran(NamedTuple):
    status: int
    out: str
    err: str


Run = Callable[..., Ran]


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder with photo.png and picture.sg in it, and encodes of less than a second."""
    monkeypatch.chdir(tmp_path)
    PHOTO.save("photo.png")
    Path("picture.sg").write_bytes(golden_path("v2-color.sg").read_bytes())
    shorten(monkeypatch, 60)


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Run:
    def run_here(*arguments: str) -> Ran:
        try:
            status = cli.main(arguments)
        except SystemExit as end:
            status = int(end.code or 0)
        return Ran(status, *capfd.readouterr())

    return run_here


def start(*arguments: str, module: bool = True, binary: bool = False, **options: Any) -> subprocess.Popen[Any]:
    command = [sys.executable, "-m", "sgmethod"] if module else [str(Path(sys.executable).parent / "sgmethod")]
    return subprocess.Popen([*command, *arguments], text=not binary, **options)


def start_interruptible(*arguments: str, **options: Any) -> subprocess.Popen[Any]:
    """A process that hears of Ctrl-C even where a shell's background jobs do not.

    Its coverage is not measured: an interrupt while coverage holds its own lock leaves it locked for ever.
    """
    environment = {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE_")}
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return start(*arguments, env=environment, **options)
    finally:
        signal.signal(signal.SIGINT, before)


def names() -> set[str]:
    return {path.name for path in Path().iterdir()}


def assert_refused(ran: Ran, why: str) -> None:
    """Exit status 2, one line that says why, and no file beside those there were."""
    assert ran.status == 2
    assert ran.out == ""
    assert re.fullmatch(r"sgmethod: .+\n", ran.err), ran.err
    assert why in ran.err
    assert names() <= {"photo.png", "picture.sg", "input", "folder", "folder.sg"}


def rest_of(terminal: int) -> bytes:
    seen = b""
    try:
        while block := os.read(terminal, 1000):
            seen += block
    except OSError:  # how a terminal ends
        pass
    os.close(terminal)
    return seen


def on_terminal(*arguments: str, streams: str) -> tuple[int, str, bytes]:
    """The exit status of a process with a terminal in place of some streams, and what it prints elsewhere and there."""
    ours, theirs = pty.openpty()
    pipes = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE)
    process = start(*arguments, **pipes | dict.fromkeys(streams.split(), theirs))
    os.close(theirs)
    seen = rest_of(ours)
    return process.wait(30), "".join(filter(None, process.communicate())), seen
