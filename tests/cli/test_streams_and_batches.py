"""Standard input and output, every format, several pictures, what may not be replaced, and comparing."""

from __future__ import annotations

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image

from sgmethod import decode
from sgmethod.cli import encoding, naming
from sgmethod.cli.terminal import bar, remaining, throughput_text
from sgmethod.client import RemoteEncoded
from sgmethod.errors import ImageError
from sgmethod.io.pictures import SUFFIXES, picture_file
from sgmethod.many import processes
from sgmethod.metrics import psnr, ssimulacra2
from sgmethod.trace import TracePoint
from tests.cli.conftest import PHOTO, Ran, Run, names, on_terminal, start, start_interruptible
from tests.many.killing import Killer
from tests.support.processes import TIMEOUT_S
from tests.support.profiles import OTHER

GOLDEN = "picture.sg"
SRGB_ALREADY = (60, 120, 200)


def piped(*arguments: str, data: bytes) -> tuple[int, bytes, bytes]:
    process = start(*arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, binary=True)
    out, err = process.communicate(data)
    return process.returncode, out, err


def test_standard_input_and_output() -> None:
    status, data, err = piped("encode", "-", "-", "--gaussians", "9", data=Path("photo.png").read_bytes())
    assert (status, data[:2]) == (0, b"\xd3\xc2")
    assert re.fullmatch(rb"standard input -> standard output: 128 x 96: .*\n", err)
    assert piped("encode", "-", "--gaussians", "9", "--quiet", data=Path("photo.png").read_bytes()) == (0, data, b"")
    status, picture, err = piped("decode", "-", "-", data=data)
    assert (status, err.count(b"\n")) == (0, 1)
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(picture))), decode(data))
    status, out, err = piped("info", "-", data=data)
    assert (status, err) == (0, b"")
    assert out.startswith(b"picture         128 x 96 pixels\n")
    assert names() == {"photo.png", "picture.sg"}  # none called "-"


@pytest.mark.parametrize("arguments", [("decode", GOLDEN, "-"), ("info", GOLDEN), ("--version",), ("--help",)])
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_closed_standard_output(arguments: tuple[str, ...], unbuffered: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    reader, writer = os.pipe()
    os.close(reader)
    process = start(*arguments, stdout=writer, stderr=subprocess.PIPE)
    os.close(writer)
    assert process.communicate()[1] == ""
    assert process.returncode == 141


@pytest.mark.parametrize("stderr", ["2>&-", "2>/dev/full"])
def test_an_error_stream_that_cannot_be_written(stderr: str) -> None:
    """Files and exit statuses are as ever, and nothing that belongs there goes elsewhere."""

    def ran(*arguments: str) -> tuple[int, bytes]:
        command = ["sh", "-c", f'"$@" {stderr}', "sh", sys.executable, "-m", "sgmethod", *arguments]
        done = subprocess.run(command, stdout=subprocess.PIPE, check=False)
        return done.returncode, done.stdout

    status, data = ran("encode", "photo.png", "-", "--bytes", "300", "--effort", "1", "--quiet")
    assert (status, data[:2], len(data) <= 300) == (0, b"\xd3\xc2", True)
    PHOTO.save("other.png")
    both = ("photo.png", "other.png", "--output-dir", "out", "--bytes", "300", "--effort", "1")
    assert ran("encode", *both)[0] == 0
    assert len(list(Path("out").glob("*.sg"))) == 2
    assert ran("info", "missing.sg") == (2, b"")


def test_no_bytes_for_a_terminal() -> None:
    status, err, seen = on_terminal("decode", GOLDEN, "-", streams="stdout")
    assert (status, seen) == (2, b"")
    assert "standard output is a terminal" in err
    assert "standard input is a terminal" in on_terminal("info", "-", streams="stdin")[1]


@pytest.mark.parametrize("suffix", [*SUFFIXES, ".JPG"])
def test_the_suffix_decides_the_format(run: Run, suffix: str) -> None:
    ran = run("decode", GOLDEN, f"out{suffix}")
    assert (ran.status, ran.err) == (0, "")
    kind = SUFFIXES[suffix.lower()]
    assert f", {kind}, " in ran.out
    picture = Image.open(f"out{suffix}")
    assert picture.format == kind.upper()
    pixels = decode(Path(GOLDEN).read_bytes())
    found = np.asarray(picture.convert("RGB"))
    assert np.array_equal(found, pixels) if kind in ("PNG", "PPM") else psnr(found, pixels) > 35  # seen: 37.6 at least


def test_every_format_but_ppm_says_srgb() -> None:
    pixels = np.full((16, 16, 3), SRGB_ALREADY, np.uint8)
    for kind in ("JPEG", "WebP"):
        data = picture_file(pixels, kind)
        profile = Image.open(io.BytesIO(data)).info["icc_profile"]
        assert b"sRGB" in profile.replace(b"\0", b"")
        assert int.from_bytes(profile[:4], "big") == len(profile)
        assert data == picture_file(pixels, kind)
    assert Image.open(io.BytesIO(picture_file(pixels, "PNG"))).info["srgb"] == 0
    assert b"colrnclx\0\1\0\r" in picture_file(pixels, "AVIF")  # the code points of sRGB: 1 and 13


@pytest.mark.parametrize(("kind", "most"), [("JPEG", 65_500), ("WebP", 16_383), ("AVIF", 16_384)])
def test_a_picture_that_a_format_cannot_hold(kind: str, most: int, capfd: pytest.CaptureFixture[str]) -> None:
    for height, width in ((1, most), (most, 1)):
        size = Image.open(io.BytesIO(picture_file(np.zeros((height, width, 3), np.uint8), kind))).size
        assert size == (width, height)
    with pytest.raises(ImageError, match=f"at most {most:,} pixels per side"):
        picture_file(np.zeros((1, most + 1, 3), np.uint8), kind)
    assert capfd.readouterr() == ("", "")


def test_the_name_left_out(run: Run) -> None:
    Path("folder").mkdir()
    PHOTO.save("folder/photo.of.me.jpg")
    assert run("encode", "folder/photo.of.me.jpg", "--gaussians", "9").status == 0
    assert run("encode", "photo.png", "--gaussians", "9").status == 0
    assert names() == {"photo.png", "picture.sg", "photo.sg", "folder"}
    assert {path.name for path in Path("folder").iterdir()} == {"photo.of.me.jpg", "photo.of.me.sg"}
    assert naming.sg_beside("IMG.1234") == "IMG.1234.sg"


def test_odd_names() -> None:
    """Bytes that are no text, and a line break, each in one line of what is printed."""
    for name in (b"caf\xe9.png", b"two\nlines.png"):
        PHOTO.save(os.fsdecode(name))
        status, out, err = piped("encode", os.fsdecode(name), "--gaussians", "9", "--output-dir", "out", data=b"")
        assert (status, err, out.count(b"\n")) == (0, b"", 2)
    written = {os.fsencode(path.name) for path in Path("out").iterdir()}
    assert written == {b"caf\xe9.sg", b"two\nlines.sg", b"manifest.jsonl"}


def test_no_clobber(run: Run) -> None:
    before = Path(GOLDEN).read_bytes()
    skipped = f"{GOLDEN} already exists: skipped\n"
    assert run("encode", "photo.png", GOLDEN, "--no-clobber") == Ran(0, skipped, "")
    assert run("decode", GOLDEN, "photo.png", "--no-clobber").out == "photo.png already exists: skipped\n"
    assert run("encode", "photo.png", GOLDEN, "--no-clobber", "--quiet") == Ran(0, "", "")
    assert Path(GOLDEN).read_bytes() == before
    with Image.open("photo.png") as kept:
        assert kept.size == (128, 96)
    assert run("encode", "photo.png", "new.sg", "--no-clobber", "--gaussians", "9").status == 0
    assert Path("new.sg").exists()


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_several_pictures(run: Run, jobs: str) -> None:
    for name in ("one.png", "two.png"):
        PHOTO.save(name)
    Path("bad.jpg").write_bytes(b"hello")
    PHOTO.save("moves.gif", save_all=True, append_images=[PHOTO.rotate(180)])
    Path("out").mkdir()
    Path("out/two.sg").write_bytes(b"before")
    pictures = ["bad.jpg", "one.png", "missing.png", "two.png", "moves.gif"]
    settings = ["--gaussians", "9", "--output-dir", "out", "--jobs", jobs, "--no-clobber"]
    ran = run("encode", *pictures, *settings)
    assert ran.status == 1
    *lines, summary = ran.out.splitlines()
    assert lines[0] == "out/two.sg already exists: skipped"
    assert {line.split(": ")[0] for line in lines[1:]} == {"one.png -> out/one.sg", "moves.gif -> out/moves.sg"}
    size = Path("out/one.sg").stat().st_size + Path("out/moves.sg").stat().st_size
    assert re.fullmatch(rf"2 encoded, 1 skipped, 2 failed: {size} bytes, \d+\.\d s", summary)
    note, *errors = ran.err.splitlines()
    assert note == "sgmethod: note: moves.gif: only the first of several pictures is used"
    assert any(line.startswith("sgmethod: bad.jpg: the file is not a PNG") for line in errors)
    assert any(line.startswith("sgmethod: missing.png: cannot read missing.png: No such file") for line in errors)
    assert len(errors) == 2
    assert Path("out/two.sg").read_bytes() == b"before"
    again = run("encode", "one.png", *settings[:2], "--output-dir", "deeper/still", "--json")
    assert again.status == 0
    assert json.loads(again.out).items() >= {"input": "one.png", "output": "deeper/still/one.sg", "width": 128}.items()
    assert re.fullmatch(r"1 encoded, 0 skipped, 0 failed: .*\n", again.err)
    if jobs == "1":  # other processes make the steps that this one is spared
        assert Path("deeper/still/one.sg").read_bytes() == Path("out/one.sg").read_bytes()


def test_jobs_that_do_not_begin(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "_work", os.abort)
    for name in ("one.png", "two.png"):
        PHOTO.save(name)
    ran = run("encode", "one.png", "two.png", "--output-dir", "out", "--jobs", "2")
    assert ran.status == 2
    assert ran.err.endswith(f"sgmethod: {processes.NOT_BEGUN}\n")


def test_a_job_that_is_killed(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its picture is named, and the rest is made."""
    send = processes._Workers._send

    def kills(workers: Any, pipe: Any, task: Any) -> None:
        send(workers, pipe, replace(task, picture=Killer()) if task.picture == "kills.png" else task)

    monkeypatch.setattr(processes._Workers, "_send", kills)
    pictures = ["kills.png", "one.png", "two.png", "three.png"]
    for name in pictures:
        PHOTO.save(name)
    ran = run("encode", *pictures, "--output-dir", "out", "--jobs", "2", "--gaussians", "9", "--effort", "1")
    assert (ran.status, ran.err) == (1, f"sgmethod: kills.png: {processes.ENDED}\n")
    assert ran.out.splitlines()[-1].startswith("3 encoded, 0 skipped, 1 failed: ")


@pytest.mark.thorough
@pytest.mark.parametrize("after", [0, 2])
def test_interrupted_jobs_end(after: float) -> None:
    """Slow: Ctrl-C, while two processes start or encode, this long after both are there; and none is left."""
    for name in ("one.png", "two.png", "three.png"):
        PHOTO.resize((512, 384)).save(name)
    pictures = ["one.png", "two.png", "three.png"]
    process = start_interruptible(
        *("encode", *pictures, "--output-dir", "out", "--jobs", "2", "--profile", OTHER, "--time-limit", "60"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    until = time.monotonic() + TIMEOUT_S
    while len(group(process.pid)) < 4 and time.monotonic() < until:  # us, two jobs, and multiprocessing's tracker
        time.sleep(0.05)
    time.sleep(after)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=TIMEOUT_S)
    assert (process.returncode, out) == (130, "")
    assert err == "sgmethod: interrupted: 0 of 3 done; --resume continues\n"
    while group(process.pid) and time.monotonic() < until:
        time.sleep(0.05)
    assert group(process.pid) == []


def test_ctrl_c_while_a_process_begins() -> None:
    """It was lost. The process that begins ends with this one, and not by itself."""
    program = """
import os, signal, subprocess, sys
from sgmethod.many import processes
signal.signal(signal.SIGINT, signal.default_int_handler)  # shells let commands in the background ignore it
with processes._uninterrupted():
    os.kill(os.getpid(), signal.SIGINT)
    child = "import signal; print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []), flush=True)"
    subprocess.run([sys.executable, "-c", child], check=True)
print("not interrupted")
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert ran.stdout == "True\n"
    assert ran.stderr.endswith("KeyboardInterrupt\n")


def group(leader: int) -> list[str]:
    """The running processes of a process group."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            _, _, rest = stat.read_text().rpartition(") ")
        except OSError:
            continue
        if rest.split()[2] == str(leader) and rest[0] != "Z":
            found.append(stat.parent.name)
    return found


def test_seconds_left() -> None:
    first = TracePoint(1.0, 1, 1000, 17.5, 0, 9, "joint", 0.05)

    def drawn(phase: str, share: float, waited_s: float = 0.0) -> str:
        return bar([first, TracePoint(6.0, 1, 1000, 28.456, 0, 100, phase, share)], 8.5, 6.0 + waited_s)

    assert drawn("joint", 0.3).endswith("  8.5 s, 14 s left")
    assert drawn("joint", 0.3, waited_s=4).endswith("  8.5 s, 10 s left")  # points of large pictures are seconds apart
    assert [drawn(phase, 0.9)[:10] for phase in ("fit", "search")] == ["fit    [##", "search [##"]
    assert drawn("done", 1.0).startswith("write  [##")
    for share, waited_s in ((0.1, 0), (0.9, 60), (1.0, 0)):  # too early, longer than it should take, the end
        assert drawn("joint", share, waited_s).endswith("  8.5 s")
    assert [remaining(seconds) for seconds in (None, 0.2, 119, 120, 32400)] == [
        *("", ", 0 s left", ", 119 s left", ", 2 min left", ", 9 h left")
    ]
    assert [throughput_text(rate) for rate in (0.0895, 0.999, 2.5)] == [
        "11.2 s a picture",
        "1 s a picture",
        "2.5 pictures/s",
    ]


def test_jobs_of_a_batch_are_found_again_on_a_server(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a key for each picture and what is asked of it."""
    asked: list[tuple[str | None, str | None]] = []

    def encode(*_: object, **options: Any) -> RemoteEncoded:
        asked.append((options.get("idempotency_key"), options.get("priority")))
        return RemoteEncoded(b"", {}, [], [])

    monkeypatch.setattr(encoding, "_client_for", lambda _: Mock(encode=encode))
    Path("same.png").write_bytes(Path("photo.png").read_bytes())
    line = ["--server", "http://127.0.0.1:1", "--json", "--gaussians"]
    for number in ("9", "9", "8"):
        assert run("encode", "photo.png", "same.png", "--output-dir", "out", *line, number).status == 0
    assert {priority for _, priority in asked} == {"bulk"}
    assert asked[:2] == asked[2:4]
    assert len({key for key, _ in asked}) == 4
    assert run("encode", "photo.png", "one.sg", *line, "9").status == 0
    assert asked[-1] == (None, None)


def test_compare(run: Run) -> None:
    assert run("encode", "photo.png", "out.sg", "--gaussians", "50").status == 0
    ran = run("compare", "photo.png", "out.sg")
    db = psnr(decode(Path("out.sg").read_bytes()), np.asarray(PHOTO))
    assert ran.out.splitlines() == [
        f"PSNR            {db:.2f} dB",
        f"SSIMULACRA 2    {ssimulacra2(decode('out.sg'), np.asarray(PHOTO)):.4g}",
    ]
    PHOTO.resize((200, 180)).save("large.png")
    ran = run("compare", "large.png", "large.png", "--json")
    found = json.loads(ran.out)
    assert found == {"psnr": None, "ssimulacra2": 100.0}
    Path("bad.png").write_bytes(b"hello")
    Path("folder").mkdir()
    ran = run("compare", "large.png", "bad.png")
    assert ran.status == 2
    assert ran.err.startswith("sgmethod: bad.png: the file is not a PNG")


def test_what_is_left_out_is_noted(run: Run) -> None:
    Image.new("RGBA", (64, 48), (10, 200, 30, 99)).save("input.png", compress_level=0)  # larger than its .sg files
    ran = run("encode", "input.png", "out.sg", "--gaussians", "9")
    assert (ran.status, ran.err) == (0, "")
    note = "transparency is composited over white\n"
    ran = run("encode", "input.png", "copy.sg", "--gaussians", "9", "--profile", OTHER, "--time-limit", "0.3")
    assert (ran.status, ran.err) == (0, f"sgmethod: note: input.png: {note}")
    assert run("encode", "input.png", "out.sg", "--gaussians", "9", "--quiet") == Ran(0, "", "")
    for kind, mode in (("png", "RGBA"), ("webp", "RGBA"), ("avif", "RGBA"), ("jpg", "RGB"), ("ppm", "RGB")):
        ran = run("decode", "out.sg", f"out.{kind}")
        notes = "" if mode == "RGBA" else f"sgmethod: note: out.sg: {SUFFIXES[f'.{kind}']} has no alpha channel: {note}"
        assert (ran.status, ran.err) == (0, notes)
        picture = Image.open(f"out.{kind}")
        assert picture.mode == mode
        if mode == "RGBA":
            assert np.abs(np.asarray(picture)[..., 3].astype(int) - 99).max() < 3
        else:
            assert np.abs(np.asarray(picture).reshape(-1, 3).mean(0) - [160, 234, 168]).max() < 4
    assert run("compare", "input.png", "out.sg").err.count(note) == 2
