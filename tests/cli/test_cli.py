"""The command line: what it writes and prints, and one line on stderr for whatever it refuses."""

from __future__ import annotations

import errno
import io
import json
import os
import pty
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image

import sgmethod
from sgmethod import codec, decode, info
from sgmethod.budget import Budget
from sgmethod.cli import arguments, decoding, paths, terminal
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import psnr
from sgmethod.profiles import DEFAULT_PROFILE, PROFILE_NAMES
from sgmethod.trace import TracePoint
from tests.cli.conftest import PHOTO, Ran, Run, assert_refused, names, on_terminal, rest_of, start, start_interruptible
from tests.support import processes
from tests.support.data import ROOT, code_in, golden_path
from tests.support.pictures import saved
from tests.support.profiles import OTHER

FIGURES = {"bytes", "bpp", "psnr", "ssimulacra2", "gaussians", "steps", "seconds", "width", "height"}
ENCODE = "encode photo.png out.sg "
DECODE = "decode picture.sg out.png "


def test_encode_and_decode(run: Run) -> None:
    ran = run("encode", "photo.png", "out.sg", "--bytes", "700", "--json")
    assert (ran.status, ran.err) == (0, "")
    assert ran.out.count("\n") == 1
    figures = json.loads(ran.out)
    assert figures.keys() >= FIGURES
    data = Path("out.sg").read_bytes()
    assert figures["bytes"] == len(data) <= 700
    assert figures["bpp"] == 8 * len(data) / (128 * 96)
    assert (figures["width"], figures["height"]) == (128, 96)
    assert figures["gaussians"] == info(data).gaussians

    ran = run("decode", "out.sg", "out.png")
    size = Path("out.png").stat().st_size
    assert ran == Ran(0, f"out.sg -> out.png: 128 x 96 pixels, PNG, {size:,} bytes\n", "")
    pixels = np.asarray(Image.open("out.png"))
    assert np.array_equal(pixels, decode(data))
    assert figures["psnr"] == pytest.approx(psnr(pixels, np.asarray(PHOTO)))
    assert names() == {"photo.png", "picture.sg", "out.sg", "out.png"}


@pytest.mark.parametrize(
    ("line", "view"),
    [
        ("--region 3,5,20,11 --scale 2.5 --prefix 0.5", {"scale": 2.5, "region": (3, 5, 20, 11), "prefix": 0.5}),
        ("--no-texture", {"texture": False}),
        ("--width 20 --height 9", {"width": 20, "height": 9}),
        ("--height 111", {"height": 111}),
        ("--region 4,6,10,20 --width 40", {"region": (4, 6, 10, 20), "width": 40}),
    ],
)
def test_views(run: Run, line: str, view: dict[str, Any]) -> None:
    path = golden_path("v2-texture.sg")
    assert run("decode", str(path), "out.png", "--quiet", *line.split()) == Ran(0, "", "")
    assert np.array_equal(np.asarray(Image.open("out.png")), sgmethod.open(path).pixels(**view))


def test_arguments_reach_the_encoder(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    real, calls = codec.encode, []

    def spy(*arguments: Any, **named: Any) -> codec.Encoded:
        calls.append((arguments[1:], {k: v for k, v in named.items() if k != "on_progress"}))
        return real(arguments[0], bytes=500, effort=1)

    monkeypatch.setattr(codec, "encode", spy)
    for budget in (Budget("gaussians", 12), Budget("psnr", 15.5), Budget("bpp", 1.25), Budget("bytes", 500)):
        given = ["--profile", OTHER, "--time-limit", "5", f"--{budget.kind}", str(budget.value)]
        assert run("encode", "photo.png", "out.sg", "--quiet", *given) == Ran(0, "", "")
        named = {"profile": OTHER, "tune": None, "effort": None, "measure": False}
        given_budget, options = calls.pop()
        assert 0 < options.pop("time_limit_s") <= 5  # counted from the start of the command
        assert (given_budget, options) == ((budget,), named)
    assert run("encode", "photo.png", "out.sg", "--quiet", "--tune", "visual", "--effort", "2") == Ran(0, "", "")
    assert {name: calls[0][1][name] for name in ("tune", "effort")} == {"tune": "visual", "effort": 2}


def test_summary_and_trace(run: Run) -> None:
    ran = run("encode", "photo.png", "out.sg", "--gaussians", "20", "--trace", "trace.json")
    assert (ran.status, ran.err) == (0, "")
    size = Path("out.sg").stat().st_size
    assert re.fullmatch(
        rf"photo\.png -> out\.sg: 128 x 96: {size} bytes, \d\.\d{{4}} bpp, SSIMULACRA 2 -?\d+\.\d "
        r"\([a-z ]+\), \d+\.\d\d dB, (?:1\d|20) Gaussians, \d+\.\d s\n",
        ran.out,
    )
    written = json.loads(Path("trace.json").read_text())
    assert written["stats"]["bytes"] == size
    assert written["stats"].keys() >= FIGURES
    seconds = [point["seconds"] for point in written["trace"]]
    assert seconds == sorted(seconds)
    assert written["trace"][-1]["phase"] == "done"
    assert written["trace"][-1]["bytes"] == size


@pytest.mark.parametrize(
    ("name", "parts", "lines"),
    [
        ("v2-grey", "headers texture alpha payload", {"picture": "48 x 40 pixels", "grey": "yes", "alpha": "no"}),
    ],
)
def test_info(run: Run, name: str, parts: str, lines: dict[str, str]) -> None:
    assert_info_shows(run, name, parts, lines)


def assert_info_shows(run: Run, name: str, parts: str, lines: dict[str, str]) -> None:
    data = golden_path(f"{name}.sg").read_bytes()
    Path("picture.sg").write_bytes(data)
    ran = run("info", "picture.sg", "--json")
    assert (ran.status, ran.err) == (0, "")
    assert json.loads(ran.out) == json.loads(json.dumps(info(data).to_dict()))
    ran = run("info", "picture.sg")
    assert (ran.status, ran.err) == (0, "")
    shown = {line[:16].strip(): line[16:] for line in ran.out.splitlines()}
    assert shown.items() >= lines.items()
    bits = {name: int(part.replace(",", "")) for name, part in re.findall(r"(\w+) ([\d,]+) \(", shown["bits"])}
    assert bits.keys() == {*parts.split()}
    assert sum(bits.values()) == 8 * len(data)


@pytest.mark.parametrize("module", [True, False])
def test_version(module: bool) -> None:
    out, err = start("--version", module=module, stdout=subprocess.PIPE, stderr=subprocess.PIPE).communicate()
    assert re.fullmatch(r"sgmethod \d+\.\d+\.\d+(rc\d+)?\n", out)
    assert err == ""


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("", "COMMAND"),
        ("compress photo.png out.sg", "'compress'"),
        (ENCODE + "--quality best", "quality is a number, or one of preview, web, archive"),
        ("encode", "IN [OUT.sg]"),
        ("decode picture.sg", "OUT"),
        ("encode ''", "a file name must not be empty"),
        ("encode .", ". is a folder: to encode the pictures in it, use --output-dir out"),
        ("encode photo.png ''", "a file name must not be empty"),
        ("encode photo.png a.sg -o b.sg", "3 names given"),
        ("encode photo.png -o a.sg --output-dir folder", "--output cannot be combined with --output-dir"),
        ("decode - --output-dir folder", "standard input"),
        ("decode folder --output-dir folder", "folder contains no file ending in .sg"),
        ("encode folder --output-dir folder", "folder contains no file ending in .apng, .avif"),
        ("decode picture.sg ./folder/../picture.sg --output-dir folder", "would both become folder/picture.png"),
        (ENCODE + "--bytes many", "a size is a number of bytes, such as 20000, 20k or 1.5MB, not 'many'"),
        (ENCODE + "--bytes 0.0105k", "whole"),
        (ENCODE + "--bytes 9e999999k", "a size is a number of bytes"),
        (ENCODE + "--server 127.0.0.1:8000", "must begin with http:// or https://, got '127.0.0.1:8000'"),
        (DECODE + "--width 0", "a width is a whole number from 1 to 65536"),
        (DECODE + "--width 20 --scale 2", "--scale cannot be combined with --width or --height"),
        ("encode photo.png out.png", "the output out.png must end in .sg"),
        ("encode photo.png --output-dir folder --trace t.json", "--trace"),
        ("encode photo.png --output-dir photo.png", "cannot write photo.png: File exists"),
        ("encode photo.png ./photo.png --output-dir folder", "would both become folder/photo.sg"),
        (ENCODE + "--jobs 0", "from 1 to 256"),
        ("decode picture.sg out.gif", "must end in one of .png, .jpg"),
        ("compare photo.png picture.sg", "differ in size: 128 x 96 and 48 x 40"),
        ("info", "IN.sg"),
        (ENCODE + "more", "--output-dir"),
        (DECODE + "--more", "unrecognized arguments: --more (see: sgmethod decode --help)"),
        (ENCODE + "--qualty 60", "did you mean --quality? (see: sgmethod encode --help)"),
        (DECODE + "--widht=60", "--widht=60; did you mean --width? (see: sgmethod decode --help)"),
        (ENCODE + "--tune psn", "did you mean psnr? (see: sgmethod encode --help)"),
        ("encod photo.png", "did you mean encode? (see: sgmethod --help)"),
        ("info picture.sg more", "unrecognized arguments: more"),
        (ENCODE + "--bp 1", "--bp"),
        (ENCODE + "--bpp x", "--bpp"),
        (ENCODE + "--bpp 1 --bytes 500", "not allowed with"),
        (ENCODE + "--bytes 11", "at least"),
        (ENCODE + "--profile best", "'best'"),
        (ENCODE + "--tune best", "'best'"),
        ("encode missing.png out.sg", "cannot read missing.png: No such file"),
        ("encode 'two\nlines' out.sg", "cannot read two lines"),
        ("encode '\x1b[2J' out.sg", r"cannot read \x1b[2J: No such file"),
        ("encode picture.sg out.sg", "picture.sg: the file is"),
        ("preview picture.sg", "picture.sg: the file is"),
        ("info photo.png", "photo.png: this is not an .sg file"),
        ("decode missing.sg out.png", "cannot read missing.sg: No such file"),
        ("decode photo.png out.png", "photo.png: this is not an .sg file"),
        (DECODE + "--region 1,2,3,x", "four whole numbers"),
    ],
)
def test_refused_in_one_line(run: Run, line: str, why: str) -> None:
    Path("folder").mkdir()
    assert_refused(run(*shlex.split(line)), why)


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("encode photo.png missing/out.sg", "cannot write missing/out.sg: No such file"),
        ("encode photo.png folder.sg", "cannot write folder.sg: Is a directory"),
        ("encode photo.png /proc/out.sg", "cannot write /proc/out.sg"),  # where even root cannot write
        ("encode photo.png --output-dir /proc/out", "cannot write /proc/out"),
        (f"encode photo.png {'o' * 300}.sg", "name too long"),
        ("encode photo.png out.sg --trace missing/trace.json", "cannot write missing/trace.json: No such file"),
        ("encode picture.sg picture.sg", "different files"),
        ("encode picture.sg", "is named like an .sg file"),
        ("encode photo.png out.sg --trace out.sg", "different files"),
        ("decode picture.sg missing/out.png", "cannot write missing/out.png: No such file"),
        ("decode picture.sg picture.sg", "different files"),
    ],
)
def test_what_cannot_be_written_is_known_before_the_work(
    run: Run, monkeypatch: pytest.MonkeyPatch, line: str, why: str
) -> None:
    work = Mock(side_effect=AssertionError("begins to work"))
    Path("folder").mkdir()
    Path("folder.sg").mkdir()
    monkeypatch.setattr(codec, "encode", work)
    monkeypatch.setattr(decoding, "SgFile", work)
    assert_refused(run(*shlex.split(line)), why)
    assert Path("photo.png").read_bytes().startswith(b"\x89PNG")
    assert list(Path("folder").iterdir()) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_permissions_are_known_before_the_work(run: Run) -> None:
    Path("folder").mkdir()
    Path("folder").chmod(0o500)
    assert_refused(run("encode", "photo.png", "folder/out.sg"), "Permission denied")
    Path("picture.sg").chmod(0o400)
    assert_refused(run("encode", "photo.png", "picture.sg"), "Permission denied")


def damaged_tiff() -> bytes:
    data = bytearray(saved(PHOTO, "TIFF", compression="tiff_lzw"))
    data[100:400] = b"\xff" * 300
    return bytes(data)


def test_what_libtiff_prints_is_not_shown(run: Run, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(sgmethod.ImageError):
        read_image_8_bit(damaged_tiff())
    noise = capfd.readouterr().err
    assert noise  # would stand beside our line
    Path("input").write_bytes(damaged_tiff())
    ran = run("encode", "input", "out.sg")
    assert noise not in ran.err
    assert_refused(ran, "")
    os.write(2, b"stderr is back\n")
    assert capfd.readouterr().err == "stderr is back\n"


def test_endless_input(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paths, "MAX_INPUT_BYTES", 1 << 20)
    assert_refused(run("info", "/dev/zero"), "larger than 1,048,576 bytes")


def test_a_disk_that_fills_up_leaves_nothing(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", Mock(side_effect=OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))))
    arguments = ["photo.png", "out.sg", "--gaussians", "9", "--trace", "trace.json"]
    assert_refused(run("encode", *arguments), "cannot write trace.json: No space left")
    assert_refused(run("decode", "picture.sg", "out.png"), "cannot write out.png: No space left")


def test_too_little_memory(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoding, "SgFile", Mock(side_effect=MemoryError))
    assert_refused(run("decode", "picture.sg", "out.png"), "memory")


def test_interrupt_of_a_process() -> None:
    """Ctrl-C in the middle of a fit; the progress on the terminal says when that is."""
    ours, theirs = pty.openpty()
    arguments = ["photo.png", "out.sg", "--profile", OTHER, "--time-limit", "60"]
    process = start_interruptible("encode", *arguments, stdout=subprocess.PIPE, stderr=theirs)
    os.close(theirs)
    seen = b""
    while b"fit" not in seen:
        seen += os.read(ours, 1000)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=30)
    seen += rest_of(ours)
    assert process.returncode == 130
    assert out == ""
    assert b"sgmethod: interrupted: out.sg was not written" in seen
    assert b"Traceback" not in seen
    assert names() == {"photo.png", "picture.sg"}


def test_progress_on_a_terminal() -> None:
    command = ("encode", "photo.png", "out.sg", "--gaussians", "9", "--time-limit", "1")
    assert on_terminal(*command, "--quiet", streams="stderr") == (0, "", b"")
    status, _, seen = on_terminal(*command, streams="stderr")
    assert status == 0
    first, start, *lines, last = seen.split(b"\r")
    assert (first, start, last) == (b"", b"start\x1b[K", b"\x1b[K")  # the line is erased at the end
    lines = [line for line in lines if line != start]  # it is drawn again each second
    assert len(lines) > 0
    shown = rb"\w+ +\[[#.]{24}\] +\d+%  [\d,]+ Gaussians  \d+\.\d s(, \d+ (s|min) left)?\x1b\[K"
    assert all(re.fullmatch(shown, line) for line in lines)


def test_progress_fits_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    stream = io.StringIO()
    terminal.redraw(stream, terminal.bar([TracePoint(3.21, 500, 1000, 28.456, 0, 100, "tune", 0.8)], 3.21, 3.21))
    assert stream.getvalue() == "\rtune   [###################..\x1b[K"


@pytest.mark.parametrize("arguments", [("info", "picture.sg"), ("--version",)])
def test_stdout_is_full(arguments: tuple[str, ...]) -> None:
    with Path("/dev/full").open("w") as full:
        process = start(*arguments, stdout=full, stderr=subprocess.PIPE)
        err = process.communicate()[1]
    assert process.returncode == 2
    assert err == "sgmethod: No space left on device\n"


def commands_of(document: str) -> list[str]:
    return [line for block in code_in(document, "sh") for line in block.splitlines() if line.startswith("sgmethod ")]


@pytest.mark.parametrize("command", ["encode", "decode"])
def test_the_command_lines_page_names_every_option_and_profile(run: Run, command: str) -> None:
    text = (ROOT / "docs" / "command_line.md").read_text()
    options = set(re.findall(r"--[a-z-]+", run(command, "--help").out)) - {"--help", "--effort-"}
    assert [option for option in options if f"{option}" not in text] == []
    assert all(f"\n| `{name}`" in text for name in PROFILE_NAMES)
    assert f"\n| `{DEFAULT_PROFILE}` (default) |" in text


def small(line: str) -> str:
    """The command for a small photograph, with budgets to fit it."""
    for large, fitting in (
        ("--gaussians 5000", "--gaussians 50"),
        ("--psnr 32", "--psnr 12"),
        ("--bytes 20k", "--bytes 0.7k"),
        ("--region 100,50,320,240", "--region 8,5,32,24"),
        ("--time-limit 20", "--time-limit 1"),
    ):
        line = line.replace(large, fitting)
    return re.sub(r"(  |#).*", "", line)


def run_in_order(run: Run, lines: list[str]) -> None:
    """All of them in this folder, where each finds what those before it left."""
    Image.open("photo.png").save("photo.jpg", quality=95)
    Path("photos").mkdir(exist_ok=True)
    Image.open("photo.png").save("photos/another.jpg")
    for line in lines:
        if "--server" not in line and not set("<>|") & set(line):
            words = shlex.split(small(line))[1:]
            ran = run(*(name for word in words for name in (sorted(map(str, Path().glob(word))) or [word])))
            assert (ran.status, ran.err) == (0, ""), line


@pytest.mark.parametrize(
    ("document", "made"),
    [
        ("README.md", "photo.sg photo.png small.png"),
        ("docs/command_line.md", "photo.sg small.sg copy.sg out photo.png part.png"),
    ],
)
def test_commands_of_a_document(run: Run, document: str, made: str) -> None:
    lines = commands_of(document)
    assert len(lines) > 3
    run_in_order(run, lines)
    assert info("photo.sg").version == 2  # none has put a file of another profile in its place
    assert {*made.split()} <= names()


def test_commands_of_the_help(run: Run) -> None:
    Path("photos").mkdir(exist_ok=True)
    for name in ("photos/a.jpg", "a.png", "b.png"):
        PHOTO.save(name)
    texts = (arguments.EXAMPLES, arguments.ENCODE[1], arguments.DECODE[1], arguments.INFO[1], arguments.COMPARE[1])
    lines = re.findall(r"^  (sgmethod .*)", "\n".join(texts), re.MULTILINE)
    assert len(lines) > 15
    run_in_order(run, lines)


def test_python_of_the_readme() -> None:
    Image.open("photo.png").save("photo.jpg", quality=95)
    (example,) = code_in("README.md", "python")
    exec(compile(example, "README.md", "exec"), {})
    assert names() >= {"photo.sg", "photo.png"}
    assert np.array_equal(np.asarray(Image.open("photo.png")), decode(Path("photo.sg").read_bytes()))


KERNELS = "sgmethod.native._native", r"the compiled part .* install --editable \.; elsewhere, .*"
TORCH = "torch", r".*torch.* pip install 'sgmethod\[torch\]'"


@pytest.mark.parametrize(
    ("missing", "line"),
    [*((KERNELS, line) for line in (ENCODE, DECODE, "info picture.sg")), (TORCH, f"{ENCODE} --profile {OTHER}")],
)
def test_what_is_not_installed_is_one_clear_line(missing: tuple[str, str], line: str, tmp_path: Path) -> None:
    module, why = missing
    without = f"import sys; sys.modules['{module}'] = None  # to import it is an ImportError"
    script = f"{without}\nfrom sgmethod.cli.main import main; sys.exit(main())"
    ran = processes.run(sys.executable, "-c", script, *line.split(), folder=tmp_path, PYTHONPATH=ROOT)
    assert_refused(Ran(ran.status, ran.stdout, ran.stderr), "pip install")
    assert re.fullmatch(rf"sgmethod: {why}\n", ran.stderr)
