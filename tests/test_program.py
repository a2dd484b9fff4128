"""What else a program does: it forks, with threads at work, and sets what torch and numpy do."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

import sgmethod
import sgmethod.torch
from sgmethod.io import formats
from sgmethod.io.image import read_header
from sgmethod.profiles import DEFAULT_EFFORT, PROFILE_NAMES
from sgmethod.threads import in_parallel
from tests.support.data import ROOT
from tests.support.profiles import OTHER, shorten

PIXELS = (np.add.outer(np.arange(36), np.arange(48)) * 3).astype(np.uint8)
TIMEOUT_S = 60


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    shorten(monkeypatch, 20)


def encoded(**more: object) -> bytes:
    return sgmethod.encode(PIXELS, **({"bytes": 400, "effort": 1} | more)).data


def in_child(function: Callable[[], bytes]) -> bytes:
    """What a forked child makes. Raises AssertionError if it does not end."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.write(write, function())
        finally:
            os._exit(0)
    os.close(write)
    for _ in range(10 * TIMEOUT_S):
        if os.waitpid(child, os.WNOHANG)[0]:
            with os.fdopen(read, "rb") as file:
                return file.read()
        time.sleep(0.1)
    os.kill(child, 9)
    os.waitpid(child, 0)
    os.close(read)
    raise AssertionError("the child waits for ever")


@pytest.mark.parametrize("more", [{}, {"profile": OTHER, "bytes": 300, "effort": DEFAULT_EFFORT}], ids=["rd", "torch"])
def test_a_forked_child_encodes_as_its_parent_did(more: dict[str, object], set_threads: Callable[[int], None]) -> None:
    set_threads(2)
    expected = encoded(**more)
    assert in_child(lambda: encoded(**more)) == expected
    assert in_child(lambda: in_child(lambda: encoded(**more))) == expected


def test_a_child_forked_during_work_of_other_threads_has_threads_of_its_own(set_threads: Callable[[int], None]) -> None:
    set_threads(2)
    begun, end = threading.Barrier(3), threading.Event()
    work = threading.Thread(target=in_parallel, args=(lambda _: (begun.wait(), end.wait()), range(2)))
    work.start()
    begun.wait(TIMEOUT_S)
    try:
        assert in_child(lambda: bytes(in_parallel(lambda n: n * n, range(9)))) == bytes(n * n for n in range(9))
    finally:
        end.set()
        work.join()


@pytest.mark.filterwarnings("always::sgmethod.ImageWarning")
def test_a_child_forked_while_a_picture_is_read_reads_and_warns(monkeypatch: pytest.MonkeyPatch) -> None:
    file = io.BytesIO()
    Image.fromarray(PIXELS).save(file, "PNG", save_all=True, append_images=[Image.new("L", (48, 36))])
    begun, real = threading.Event(), formats.open_reader

    def slowly(*arguments: object) -> object:
        if threading.current_thread() is reading:
            begun.set()
            time.sleep(0.5)
        return real(*arguments)

    def warned() -> bytes:
        with warnings.catch_warnings(record=True) as caught:
            encoded_file = sgmethod.encode(file.getvalue(), bytes=400, effort=1).data
        return encoded_file + b"%d" % len(caught)

    expected = warned()
    monkeypatch.setattr(formats, "open_reader", slowly)
    reading = threading.Thread(target=read_header, args=(file.getvalue(),))
    reading.start()
    assert begun.wait(TIMEOUT_S)
    assert in_child(warned) == expected
    assert expected.endswith(b"1")
    reading.join()


@pytest.mark.filterwarnings("ignore::sgmethod.ImageWarning")
def test_reading_pictures_leaves_a_programs_warnings_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """They belong to all its threads."""
    file = io.BytesIO()
    Image.fromarray(PIXELS).save(file, "GIF", save_all=True, append_images=[Image.new("L", (48, 36))])
    seen, real = [], formats.open_reader

    def state() -> list[object]:
        return [warnings.filters, *warnings.filters, warnings.showwarning]

    def looked(*arguments: Any) -> object:
        seen.append(state())
        return real(*arguments)

    monkeypatch.setattr(formats, "open_reader", looked)
    sgmethod.encode(file.getvalue(), bytes=400, effort=1)
    sgmethod.preview(file.getvalue())
    sgmethod.encode_many([("a", file.getvalue())], tmp_path, bytes=400, effort=1)
    assert seen == [state()] * 4


INTERRUPTED = """
import signal, sys
import numpy as np
import sgmethod
picture = np.random.default_rng(0).integers(0, 256, (60, 80, 3), np.uint8)
encode = lambda: sgmethod.encode(picture, bytes=300, effort=1).data
sgmethod.set_threads(2)
steps, at, expected = 0, 0, encode()
def step(frame, event, _):
    global steps
    while frame is not None and frame.f_code.co_name != "in_parallel":
        frame = frame.f_back
    steps += frame is not None
    if frame is not None and steps == at:
        signal.raise_signal(signal.SIGINT)
for at in range(1, 100):
    steps = 0
    sys.setprofile(step)
    try:
        encode()
    except KeyboardInterrupt:
        pass
    sys.setprofile(None)
    if steps < at:  # it was not interrupted: the other thread took more of the tasks
        break
    assert at % 5 or encode() == expected
assert at > 10, at
print("works")
"""


@pytest.mark.thorough
def test_an_encode_that_is_interrupted_spoils_none_after_it() -> None:
    """At each of the first steps of work on several threads; the program ends, too."""
    ran = subprocess.run([sys.executable, "-c", INTERRUPTED], check=True, capture_output=True, timeout=TIMEOUT_S)
    assert (ran.stdout, ran.stderr) == (b"works\n", b"")


ENDS = """
import sys, threading
import sgmethod
from sgmethod.threads import in_parallel
from tests.support.data import golden_path
data = golden_path("v2-color.sg").read_bytes()
works = {
    "decode": lambda: sgmethod.decode(data),
    "info": lambda: sgmethod.info(data),
    "python": lambda: in_parallel(lambda n: sum(range(20_000)), range(40)),
}
work, begun = works[sys.argv[1]], threading.Barrier(3)
sgmethod.set_threads(3)
def loop():
    work()
    begun.wait()
    while True:
        work()
for _ in range(2):
    threading.Thread(target=loop, daemon=True).start()
begun.wait()
sum(range(int(sys.argv[2])))
"""


@pytest.mark.parametrize("work", ["decode", "info", "python"])
def test_a_program_ends_while_a_daemon_thread_works(work: str) -> None:
    for patience in (1, 100_000, 1_000_000):
        command = [sys.executable, "-c", ENDS, work, str(patience)]
        ran = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=TIMEOUT_S)
        assert ran.stderr == b""


@contextmanager
def default_dtype(kind: torch.dtype) -> Iterator[None]:
    torch.set_default_dtype(kind)
    try:
        yield
        assert torch.get_default_dtype() == kind  # as the program has set it
    finally:
        torch.set_default_dtype(torch.float32)


STATES: dict[str, Callable[[], AbstractContextManager[object]]] = {
    "doubles": lambda: default_dtype(torch.float64),
    "half floats": lambda: default_dtype(torch.bfloat16),
    "another device": lambda: torch.device("meta"),
    "no gradients": torch.no_grad,
    "inference": torch.inference_mode,
    "autocast": lambda: torch.autocast("cpu"),
    "errors of numpy": lambda: np.errstate(all="raise"),
}


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_files_are_the_same_whatever_a_program_has_set(state: str, profile: str) -> None:
    more = {} if profile == "rd" else {"profile": profile, "bytes": 300, "effort": DEFAULT_EFFORT}
    expected = encoded(**more)
    with STATES[state]():
        assert encoded(**more) == expected


Y, X = np.mgrid[0:96, 0:96]
EXTREMES = {
    "a step of one level": 100 + (X >= 48),
    "a bump": np.clip(2040 * np.exp(-(np.square(X - 48.0) + np.square(Y - 48)) / 30), 0, 255),
    "a line": 255 * (X != Y),
}


@pytest.mark.parametrize("picture", EXTREMES)
def test_arithmetic_that_underflows_is_no_error_of_a_program_that_has_numpy_raise(
    picture: str, set_threads: Callable[[int], None], tmp_path: Path
) -> None:
    set_threads(2)
    pixels = EXTREMES[picture].astype(np.uint8)
    with np.errstate(all="raise"):
        for budget in ({"bpp": 3}, {"psnr": 60}, {"quality": 99}):
            file = sgmethod.open(sgmethod.encode(pixels, tune="psnr", measure=True, **budget).data)
            assert file.pixels(scale=1 / 48).shape == (2, 2, 3)
            tiny = sgmethod.Gaussians(*(values * np.float32(1e-30) for values in file.gaussians().arrays))
            assert np.isfinite(tiny.covariances).all()
            sgmethod.write_ply(tmp_path / "tiny.ply", tiny)
            assert len(sgmethod.read_ply(tmp_path / "tiny.ply")) == len(tiny)
        assert sgmethod.preview(pixels).width == 96
        assert sgmethod.torch.fit(torch.from_numpy(pixels / 255).expand(1, 3, 96, 96), 9, steps=5).error.shape == (1,)
    with np.errstate(all="warn"):  # in the threads of a pool, too, where the caller's setting does not reach
        assert sgmethod.encode(pixels, bpp=3, tune="psnr", measure=True).stats.bytes > 0


def test_torchs_default_type_stays_the_programs_while_a_profile_computes() -> None:
    seen: list[torch.dtype] = []
    with default_dtype(torch.float64):
        encoded(profile=OTHER, effort=DEFAULT_EFFORT, on_progress=lambda _: seen.append(torch.get_default_dtype()))
    assert set(seen) == {torch.float64}
