"""Many files and folders, warnings, names of pipes, permissions, and seconds."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import threading
import time
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image

from sgmethod import SgError, codec, decode, encode
from sgmethod.cli import encoding, naming, paths, several
from sgmethod.cli.naming import Conversion
from sgmethod.trace import TracePoint
from tests.cli.conftest import PHOTO, Run, assert_refused, on_terminal, start
from tests.io.odd_files import tiff

GOLDEN = "picture.sg"  # 48 x 40


def size_of(path: str) -> tuple[int, int]:
    with Image.open(path) as picture:
        return picture.size


def test_many_files_are_decoded(run: Run) -> None:
    for name in ("one.sg", "two.sg"):
        Path(name).write_bytes(Path(GOLDEN).read_bytes())
    Path("bad.sg").write_bytes(b"hello")
    Path("out").mkdir()
    Path("out/two.png").write_bytes(b"before")
    options = ["--output-dir", "out", "--no-clobber", "--scale", "0.5"]
    ran = run("decode", "bad.sg", "one.sg", "two.sg", "missing.sg", *options)
    assert ran.status == 1
    skipped, done, summary = ran.out.splitlines()
    assert skipped == "out/two.png already exists: skipped"
    assert re.fullmatch(
        r"one\.sg -> out/one\.png: 24 x 20 pixels, PNG, [\d,]+ bytes"
        r" \(2 of 3, [\d.,]+ (?:pictures/s|s a picture), \d+ s left\)",
        done,
    )
    assert re.fullmatch(r"1 decoded, 1 skipped, 2 failed: [\d,]+ bytes, \d+\.\d s", summary)
    bad, missing = ran.err.splitlines()
    assert bad.startswith("sgmethod: bad.sg: ")
    assert missing.startswith("sgmethod: missing.sg: cannot read missing.sg: No such file")
    assert size_of("out/one.png") == (24, 20)
    assert Path("out/two.png").read_bytes() == b"before"


def test_folders(run: Run) -> None:
    """Their pictures, by suffix; nothing hidden, nothing deeper, nothing else. A pipe would be waited for.

    A name that another picture has taken keeps its suffix.
    """
    Path("photos/deeper").mkdir(parents=True)
    Path("photos/folder.png").mkdir()
    os.mkfifo("photos/pipe.png")
    for name in ("photos/b.JPG", "photos/a.png", "photos/b.webp", "photos/deeper/c.png", "photos/.d.png"):
        PHOTO.save(name)
    Path("photos/notes.txt").write_text("hello")
    assert list(naming.files_of("photos", naming.PICTURES)) == ["photos/a.png", "photos/b.JPG", "photos/b.webp"]
    ran = run("encode", "photos", "photo.png", "--output-dir", "out", "--gaussians", "9")
    assert (ran.status, ran.err) == (0, "")
    assert [line.partition(":")[0] for line in ran.out.splitlines()] == [
        "photos/a.png -> out/a.sg",
        "photos/b.JPG -> out/b.sg",
        "photos/b.webp -> out/b.webp.sg",
        "photo.png -> out/photo.sg",
        "4 encoded, 0 skipped, 0 failed",
    ]
    assert run("decode", "out", "--output-dir", "out", "--quiet") == (0, "", "")
    assert {path.name for path in Path("out").iterdir()} == {
        "manifest.jsonl",
        *(f"{name}.{suffix}" for name in ("a", "b", "b.webp", "photo") for suffix in ("sg", "png")),
    }


def test_resuming(run: Run) -> None:
    """What the manifest has is skipped, and other options make other files (more: tests/many)."""
    Path("photos").mkdir()
    for name in ("a.png", "b.png"):
        PHOTO.resize((32, 24)).save(f"photos/{name}")
    Path("photos/bad.png").write_bytes(b"hello")
    line = ["encode", "photos", "--output-dir", "out", "--resume", "--gaussians", "9", "--effort", "1"]
    assert run(*line, "--jobs", "2").out.splitlines()[-1].startswith("2 encoded, 0 skipped, 1 failed: ")
    assert run(*line).out.splitlines()[-1].startswith("0 encoded, 2 skipped, 1 failed: ")
    assert run(*line, "--tune", "psnr").out.splitlines()[-1].startswith("2 encoded, 0 skipped, 1 failed: ")


def test_resuming_needs_a_folder_and_a_manifest(run: Run) -> None:
    assert_refused(run("encode", "photo.png", "out.sg", "--resume"), "--resume needs --output-dir")
    Path("folder").mkdir()
    Path("folder/manifest.jsonl").write_text("hello")
    why = "folder/manifest.jsonl is not a manifest of sgmethod (line 1): move it away"
    assert_refused(run("encode", "photo.png", "--output-dir", "folder"), why)


def test_how_many_of_how_many_on_a_terminal() -> None:
    for name in ("a.sg", "b.sg"):
        Path(name).write_bytes(Path(GOLDEN).read_bytes())
    status, _, seen = on_terminal("decode", "a.sg", "b.sg", "--output-dir", "out", streams="stdout stderr")
    assert status == 0
    first, second, third, end = seen.decode().replace("\r\n", "\n").split("\r\x1b[K")[:4]
    assert first == "\r0 of 2: a.sg 0 s\x1b[K"
    after = r"\r1 of 2, [\d.,]+ (?:pictures/s|s a picture), \d+ s left: b\.sg 0 s\x1b\[K"
    assert re.fullmatch(rf"a\.sg -> out/a\.png: .* bytes\n{after}", second)
    assert re.fullmatch(r"b\.sg -> out/b\.png: .* bytes\n", third)
    assert end.startswith("2 decoded, 0 skipped, 0 failed: ")


def test_how_much_of_a_large_picture_on_a_terminal(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    ticks: list[Callable[[], None]] = []

    def encode(*_: object, on_progress: Callable[[TracePoint], None], **__: object) -> None:
        on_progress(TracePoint(1.0, 1, 100, 20.0, 0, 9, "joint", 0.34))
        ticks[0]()
        raise SgError("enough")

    monkeypatch.setattr(os, "isatty", lambda _: True)
    monkeypatch.setattr(several, "Ticker", lambda draw: ticks.append(draw) or Mock())
    monkeypatch.setattr(codec, "encode", encode)
    PHOTO.save("other.png")
    seen = run("encode", "photo.png", "other.png", "--output-dir", "out").err
    assert re.findall(r"\r(\d of 2).*?: (\S+)( \d+%)? \d s\x1b", seen) == [
        ("0 of 2", "photo.png", ""),
        ("0 of 2", "photo.png", " 34%"),
        ("1 of 2", "other.png", ""),
        ("1 of 2", "other.png", " 34%"),
    ]


def test_each_picture_of_many_takes_the_same_time() -> None:
    """Of 20,000, the time of each grew with those left: 8 s of a core, where all take 0.5."""
    conversions = [Conversion(f"{number}.sg", f"{number}.png") for number in range(20_000)]
    arguments = Namespace(quiet=True, no_clobber=False, began=time.perf_counter())
    began = time.process_time()
    assert several.convert_all(conversions, lambda one, _: one, "made", arguments) == 0
    assert time.process_time() - began < 2


def test_short_options_and_names_between_options(run: Run) -> None:
    for command, name, options in (
        ("encode", "photo.png", ["--quality", "10"]),
        ("decode", GOLDEN, ["--scale", "0.5"]),
    ):
        suffix = {"encode": "sg", "decode": "png"}[command]
        assert run(command, name, *options, f"a.{suffix}", "--quiet").status == 0
        assert run(command, "-o", f"b.{suffix}", *options, name, "--quiet").status == 0
        assert Path(f"a.{suffix}").read_bytes() == Path(f"b.{suffix}").read_bytes()


def warnings_of(err: str) -> list[str]:
    return re.findall(r"^sgmethod: warning: photo\.jpg: (.*)$", err, re.MULTILINE)


@pytest.mark.parametrize(
    ("line", "warned"),
    [
        ("--psnr 60 --time-limit 0.05", ["the requested PSNR is missed by"]),
        ("--bytes 13", ["the file contains only a background and no Gaussians"]),
        ("--bpp 6", ["larger than its source"]),
        ("--bpp 0.3", []),
    ],
)
def test_a_file_that_came_out_badly(run: Run, line: str, warned: list[str]) -> None:
    PHOTO.save("photo.jpg", quality=5)  # 1,400 bytes
    ran = run("encode", "photo.jpg", "out.sg", "--json", *line.split())
    assert ran.status == 0
    figures = json.loads(ran.out)
    assert figures["source_bytes"] == Path("photo.jpg").stat().st_size
    assert bool(figures["warnings"]) == bool(warned)
    assert all(any(words in text for text in figures["warnings"]) for words in warned)
    assert warnings_of(ran.err) == figures["warnings"]
    assert bool(warnings_of(run("encode", "photo.jpg", "--output-dir", "out", *line.split()).err)) == bool(warned)
    assert run("encode", "photo.jpg", "out.sg", "--quiet", *line.split()) == (0, "", "")


def test_names_of_pipes() -> None:
    """/dev/stdout is as good as -, and a pipe with a number as one with a name."""
    pixels = decode(Path(GOLDEN).read_bytes())
    for name in ("-", "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"):
        process = start("decode", GOLDEN, name, stdout=subprocess.PIPE, stderr=subprocess.PIPE, binary=True)
        out, err = process.communicate()
        assert process.returncode == 0, err
        assert np.array_equal(np.asarray(Image.open(io.BytesIO(out))), pixels)
        assert err.startswith(b"picture.sg -> standard output: ")
    Path("log").write_bytes(b"before")
    with Path("log").open("ab") as log:
        assert start("decode", GOLDEN, "/dev/stdout", "--quiet", stdout=log).wait() == 0
    assert Path("log").read_bytes().startswith(b"before\x89PNG")
    reader, writer = os.pipe()
    process = start("decode", GOLDEN, f"/dev/fd/{writer}", "--quiet", pass_fds=[writer])
    os.close(writer)
    with os.fdopen(reader, "rb") as pipe:
        assert np.array_equal(np.asarray(Image.open(io.BytesIO(pipe.read()))), pixels)
    assert process.wait() == 0


def test_pipes_by_name_for_encode_and_its_trace() -> None:
    arguments = ["encode", "photo.png", "/dev/stdout", "--gaussians", "9"]
    process = start(*arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, binary=True)
    data, err = process.communicate()
    assert (process.returncode, err.count(b"\n")) == (0, 1)
    assert decode(data).shape == (96, 128, 3)
    reader, writer = os.pipe()
    arguments = ["encode", "photo.png", "out.sg", "--gaussians", "9", "--trace", f"/dev/fd/{writer}", "--quiet"]
    process = start(*arguments, pass_fds=[writer])
    os.close(writer)
    with os.fdopen(reader) as pipe:
        assert json.load(pipe)["stats"]["gaussians"] <= 9
    assert process.wait() == 0


@pytest.mark.parametrize("text", ["0", "257", "two", "1.5", " 2", "9" * 5000])
def test_a_number_of_threads_that_there_is_not(run: Run, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setenv("SG_THREADS", text)
    assert_refused(
        run("decode", GOLDEN, "out.png"), f"SG_THREADS must be a whole number from 1 to 256, not {text[:40]!r}"
    )


@pytest.mark.parametrize("text", ["", "1", "256"])
def test_a_number_of_threads(run: Run, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    """NumPy's linear algebra gets it too; info has none."""
    monkeypatch.setenv("SG_THREADS", text)
    for command, linear in ((["encode", "--help"], text or None), (["info", GOLDEN], "1")):
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", "")
        monkeypatch.delenv("OPENBLAS_NUM_THREADS")
        assert run(*command).status == 0
        assert os.environ.get("OPENBLAS_NUM_THREADS") == linear


def test_seconds_are_those_that_somebody_waits(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """With what an encode loads, reads and draws, from the start of the command."""
    clock = iter(range(1000, 100_000))
    monkeypatch.setattr(time, "perf_counter", lambda: float(next(clock)))
    arguments = ["encode", "photo.png", "out.sg", "--gaussians", "9", "--trace", "trace.json"]
    output = run(*arguments).out
    figures = json.loads(Path("trace.json").read_text())["stats"]
    of_the_fit = json.loads(Path("trace.json").read_text())["trace"][-1]["seconds"]
    ends = next(clock) - 1
    assert figures["seconds"] == ends - 1000 > of_the_fit + 1
    assert output.endswith(f", {figures['seconds']:.1f} s\n")
    began = next(clock) + 1
    lines = run("encode", "photo.png", "--output-dir", "out", "--gaussians", "9").out.splitlines()
    assert lines[-1].endswith(f", {next(clock) - 1 - began:.1f} s")


@pytest.mark.parametrize(("limit", "left"), [("20", 11.5), ("5", encoding.SHORTEST_LIMIT_S)])
def test_a_time_limit_counts_from_the_start_of_the_command(
    run: Run, monkeypatch: pytest.MonkeyPatch, limit: str, left: float
) -> None:
    """Of the clock, whoever has the processor; not while a pipe is awaited. The command took 13 s for a limit of 10."""
    now_s, asked = [1000.0], []
    monkeypatch.setattr(time, "perf_counter", lambda: now_s[0])

    def takes(seconds: float, function: Callable[..., Any]) -> Callable[..., Any]:
        def slow(*arguments: Any, **named: Any) -> Any:
            now_s[0] += seconds
            return function(*arguments, **named)

        return slow

    def asked_for(*_: object, time_limit_s: float, **__: object) -> None:
        asked.append(time_limit_s)
        raise SgError("enough")

    monkeypatch.setattr(paths, "check_outputs", takes(1.5, paths.check_outputs))
    monkeypatch.setattr(paths, "read", takes(60, paths.read))
    monkeypatch.setattr(paths, "read_pixels", takes(7, paths.read_pixels))
    monkeypatch.setattr(codec, "encode", asked_for)
    assert run("encode", "photo.png", "out.sg", "--time-limit", limit).status == 2
    assert asked == [left]


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_pillows_warnings_are_not_printed(jobs: str) -> None:
    """Of a tag with two values instead of one."""
    for name in ("odd.tiff", "odder.tiff"):
        Path(name).write_bytes(tiff([(np.zeros((9, 9, 1), np.uint8), {296: (2, 2)})]))
    with pytest.warns(UserWarning, match="tag 296 had too many entries"):
        encode("odd.tiff", effort=1)
    arguments = ["odd.tiff", "odder.tiff", "--output-dir", "out", "--jobs", jobs, "--effort", "1"]
    assert start("encode", *arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE).communicate()[1] == ""


@pytest.mark.parametrize("command", ["encode", "preview"])
def test_pipes_into_a_folder(run: Run, command: str) -> None:
    """As from <(cat a.png) of a shell: each can be read once, and by no other process."""
    png = io.BytesIO()
    PHOTO.resize((32, 24)).save(png, "PNG")
    ends = [os.pipe() for _ in range(2)]
    for _, writer in ends:
        os.write(writer, png.getvalue())  # fits into the pipe's buffer
        os.close(writer)
    os.mkfifo("named.png")
    threading.Thread(target=Path("named.png").write_bytes, args=(png.getvalue(),), daemon=True).start()
    names = [*(f"/dev/fd/{reader}" for reader, _ in ends), "named.png"]
    ran = run(command, *names, "--output-dir", "out", "--bytes", "100", "--jobs", "2")
    assert (ran.status, ran.err) == (0, "")
    assert {path.name for path in Path("out").glob("*.sg")} == {*(f"{reader}.sg" for reader, _ in ends), "named.sg"}
    for reader, _ in ends:
        os.close(reader)
