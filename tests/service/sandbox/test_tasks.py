"""Tasks in a sandbox of their own: what they make is what the codec makes, and how they end is known."""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image, ImageCms

import sgmethod
from service.jobs.job import new_job_id
from service.pictures import WRITERS, Drawing, PictureOptions
from service.sandbox import client, confinement, frames, server, tasks
from service.sandbox.client import OutOfMemoryError, Sandbox, SandboxProcess, SandboxUnavailableError, TaskError
from service.sandbox.confinement import absent_layers
from service.sandbox.frames import Crashed, Draw, Encode, Ended, FrameError, ReadHeader, Refused, Result, Task
from service.settings import Settings
from sgmethod.io.formats import PLAIN
from tests.service.sandbox_process import TAKEN_OVER, WAITS, begun, file_of, messages_of, sandbox, task, until_end
from tests.support.data import PICTURE
from tests.support.job_table import request_of
from tests.support.pictures import SMALL, saved
from tests.support.processes import TIMEOUT_S, encoder_of, end_early, processes, wait_until
from tests.support.profiles import OTHER
from tests.support.service import FAKE_CODEC

LIMITS: dict[str, Any] = {"memory_bytes": 2**31, "cpu_s": 100, "max_pixels": 10**6}


def picture(*, drawn: bool = False, alpha: bool = False) -> Image.Image:
    """A gradient, or stripes as of a chart."""
    y, x = np.mgrid[:48, :64]
    pixels = np.stack([x * 4, y * 5, (x * y) % 256, 255 - x], -1).astype(np.uint8)
    if drawn:
        pixels = np.where((x[..., None] // 8 + y[..., None] // 8) % 2, 250, 10).repeat(4, 2).astype(np.uint8)
    return Image.fromarray(pixels if alpha else np.ascontiguousarray(pixels[..., :3]))


@pytest.fixture(scope="module")
def real() -> Iterator[Sandbox]:
    """A sandbox as the service starts it."""
    with sandbox() as (tasks, _):
        yield tasks


@pytest.fixture(scope="module")
def taken_over() -> Iterator[Sandbox]:
    """One whose encodes are programs."""
    with sandbox(TAKEN_OVER, FAKE_CODEC) as (tasks, _):
        yield tasks


def asked(tasks: Sandbox, what: Task, data: bytes) -> Result:
    with file_of(data) as file:
        return asyncio.run(tasks.ask(what, file))


def test_a_warm_sandbox_has_all_that_an_encode_imports() -> None:
    """Tasks can open no file. What the tiny encodes reach depends on the picture, so the list has to be whole."""
    program = """
import sys
import sgmethod
from service.sandbox import tasks
from tests.support.pictures import photo
picture = photo()
tasks.tiny_encode = lambda *_: b""
tasks.warm_up()
before = set(sys.modules)
for tune in ("psnr", "visual"):
    sgmethod.encode(picture, bytes=2000, tune=tune, effort=2)
print(*sorted(set(sys.modules) - before))
"""
    command = [sys.executable, "-c", program]
    assert subprocess.run(command, check=True, capture_output=True, text=True).stdout.split() == []


@pytest.mark.parametrize("kind", WRITERS)
def test_pictures_are_those_of_the_codec(real: Sandbox, kind: Any) -> None:
    """Byte for byte, on two threads as on any number."""
    info = sgmethod.info(PICTURE)
    for options in (PictureOptions(), PictureOptions(scale=1.5, region="2,3,20,9")):
        made = asked(real, Draw(**LIMITS, options=options, file_kind=kind), PICTURE).file
        assert made == Drawing.from_options(options, kind, (info.width, info.height), 10**6).draw(PICTURE)


@pytest.mark.parametrize("kind", PLAIN)
def test_every_format_is_read(real: Sandbox, kind: str) -> None:
    """Though a task can open no file, and import nothing any more."""
    image = picture().convert("P" if kind == "GIF" else "RGB")
    more = {"exif": Image.Exif(), "icc_profile": ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()}
    file = saved(image, kind, **({} if kind in ("GIF", "BMP", "PPM", "QOI") else more))
    header = asked(real, ReadHeader(**LIMITS), file).figures
    assert (header.format, header.width, header.height) == (kind, *image.size)
    made = asked(real, frames.MakePreview(**LIMITS, max_bytes=100), file).figures
    assert made == frames.PreviewFigures.model_validate(sgmethod.preview(file, 100).to_dict())


@pytest.mark.parametrize("kind", ["jpg", "webp", "avif"])
def test_other_codecs(real: Sandbox, kind: Any) -> None:
    for image in (picture(), picture(drawn=True), picture(alpha=True)):
        made = asked(real, frames.Compare(**LIMITS, file_kind=kind, size=500), saved(image)).file
        assert Image.open(io.BytesIO(made)).size == image.size


@pytest.mark.parametrize(
    ("kind", "value", "more"),
    [
        ("bpp", 2.0, {"effort": 1}),
        ("bytes", 300, {"effort": 9}),
        ("psnr", 25.0, {"tune": "psnr"}),
        ("quality", 50, {"tune": "visual"}),
        ("gaussians", 20, {"tune": "visual"}),
        ("bpp", 1.0, {"tune": "fidelity"}),
    ],
)
def test_encodes_are_those_of_the_codec(real: Sandbox, kind: Any, value: float, more: dict[str, Any]) -> None:
    """As the command line makes them, whatever the picture asks of libraries that are imported late."""
    for image in (picture(), picture(alpha=True), picture(drawn=True)):
        request = request_of(kind, value, **{"time_limit_s": 600.0, **more})
        what = Encode(**LIMITS, job_id=new_job_id(), request=request, threads=1)
        *_, result = messages_of(real, what, saved(image))
        assert isinstance(result, Result), result
        assert result.figures.bytes == len(result.file)
        how = {name: getattr(request, name) for name in ("tune", "effort", "time_limit_s")}
        same = sgmethod.encode(saved(image), sgmethod.Budget(kind, value), "rd", **how, measure=True)
        assert result.file == same.data
        assert result.figures.psnr == same.stats.to_dict()["psnr"]


@pytest.mark.thorough
def test_a_profile_that_brings_torch(real: Sandbox) -> None:
    """It is imported before the task is confined, and starts its threads afterwards."""
    pytest.importorskip("torch")
    request = request_of("bpp", 2.0, profile=OTHER, time_limit_s=2)
    what = Encode(**LIMITS, job_id=new_job_id(), request=request, threads=2)
    *_, result = messages_of(real, what, saved(picture()))
    assert isinstance(result, Result), result
    assert sgmethod.decode(result.file).shape == (48, 64, 3)


def test_what_starts_tasks_has_one_thread_and_reads_nothing() -> None:
    """A fork would lack another, and wait for it for ever."""
    with sandbox() as (tasks, number):
        assert isinstance(messages_of(tasks, task(), SMALL)[-1], Result)
        assert len([*Path("/proc", str(number), "task").iterdir()]) == 1


# Forks 1 to 3 fail, then the first two, and again the next.
NO_PROCESS = """
import os
from service.sandbox import server
server.LOOK_S, fork, tries = 0.01, os.fork, []

def sometimes():
    tries.append(None)
    if len(tries) in (1, 2, 3, 6):
        raise BlockingIOError(11, "no process")
    return fork()

os.fork = sometimes
"""


def test_no_process_to_spare(capfd: pytest.CaptureFixture[str]) -> None:
    """It says so, but not once a second; in the format of the log."""
    with sandbox(NO_PROCESS, FAKE_CODEC) as (tasks, _):

        def works() -> bool:
            with contextlib.suppress(SandboxUnavailableError):
                return isinstance(messages_of(tasks, task(), SMALL)[-1], Result)
            return False

        wait_until(works)
    lines = [json.loads(line) for line in capfd.readouterr().err.splitlines()]
    assert [line["message"] for line in lines] == ["the sandbox cannot fork: [Errno 11] no process"]


def test_a_sandbox_that_hangs_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    """It was left alone for ever. What it was asked is done by its successor."""
    monkeypatch.setattr("service.processes.LOOK_S", 0.05)
    process = SandboxProcess(Settings(workers=1), absent_layers())
    try:
        first = process.process.pid
        os.kill(first, signal.SIGSTOP)
        with file_of(SMALL) as file, Sandbox(process.requests).start(task(), file) as running:
            wait_until(lambda: process.keep_alive() or process.process.pid != first)
            *_, result = until_end(running)
        assert isinstance(result, Result)
    finally:
        process.stop(time.monotonic() + TIMEOUT_S)


@pytest.mark.parametrize(
    ("program", "end"),
    [
        ("os._exit(7)", Ended(status=7)),
        ("raise ValueError('too much')", Crashed(detail="ValueError: too much")),
        ("raise MemoryError", Refused(error="MemoryError", detail="it exceeds the memory limit")),
        ("raise ValueError('x' * 10_000)", Crashed(detail=f"ValueError: {'x' * 288}")),
        ("ctypes.string_at(0)", Ended(status=-signal.SIGSEGV)),
        ("ctypes.CDLL(None).abort()", Ended(status=-signal.SIGABRT)),
        ("pass", Ended(status=0)),
    ],
)
def test_ends(taken_over: Sandbox, program: str, end: object) -> None:
    assert messages_of(taken_over, task(), f"import ctypes, os\n{program}".encode())[-1] == end


def test_one_that_lets_go_of_its_sandbox_holds_up_no_other(taken_over: Sandbox) -> None:
    """Others waited 2 s for it, each time. It goes when its client does."""
    program = b"import os, time\nfor number in range(3, 64):\n    if number != answer._descriptor:\n        try:\n"
    program += b"            os.close(number)\n        except OSError:\n            pass\ntime.sleep(1000)"
    what = task()
    with begun(taken_over, program, what):
        for _ in range(3):
            assert messages_of(taken_over, task(), b"pass")[-1] == Ended(status=0)
        assert encoder_of(what.job_id) is not None
    wait_until(lambda: encoder_of(what.job_id) is None)


def test_a_picture_that_takes_long_gets_the_priority_of_an_encode() -> None:
    """Two of one client left an encode 2 % of a core. All its threads get it, and no short picture."""
    program = b"import threading\ndef spin():\n    while True:\n        pass\n"
    program += WAITS + b"threading.Thread(target=spin).start()\nspin()"
    what = frames.MakePreview(**LIMITS, max_bytes=100)
    with sandbox(TAKEN_OVER) as (tasks, parent), begun(tasks, program, what):
        family = processes().items()
        (number,) = (number for number, one in family if (one.parent, one.name) == (parent, "preview"))

        def niceness() -> list[int]:
            return [os.getpriority(os.PRIO_PROCESS, int(each.name)) for each in Path(f"/proc/{number}/task").iterdir()]

        begins = min(os.getpriority(os.PRIO_PROCESS, 0) + server.PICTURE_NICENESS, server.ENCODE_NICENESS)
        assert set(niceness()) == {begins}  # of one thread, or of both
        end_early(number)
        wait_until(lambda: niceness() == 2 * [server.ENCODE_NICENESS])


@pytest.mark.parametrize(
    ("limit_s", "cpu_share", "warned"), [(0.001, 0.3, True), (0.001, 0.9, False), (600, 0.3, False)]
)
def test_an_encode_says_what_a_busy_machine_cost_it(
    monkeypatch: pytest.MonkeyPatch, limit_s: float, cpu_share: float, warned: bool
) -> None:
    """With a time limit, its file got worse without a word."""
    monkeypatch.setattr(tasks.time, "thread_time", lambda: cpu_share * time.monotonic())
    answers = SimpleNamespace(send=lambda _: None, send_result=Mock())
    tasks.perform(task(limit_s), SMALL, answers)
    figures, _ = answers.send_result.call_args.args
    words = "the service was busy: the encode had a core for 30% of its time, and its time limit cut it short"
    assert figures.warnings == [words] * warned


def test_one_that_the_system_kills_is_no_fault_of_its_client(taken_over: Sandbox) -> None:
    """As when memory runs out: three decodes in 1 GB were answered 422, \"its decoder crashed\"."""
    what = task()

    def kill() -> None:
        before = None
        for _ in range(2):  # it is tried again
            wait_until(lambda: encoder_of(what.job_id) not in (None, before))  # noqa: B023
            before = encoder_of(what.job_id)
            assert before is not None
            os.kill(before, signal.SIGKILL)

    with ThreadPoolExecutor(1) as system:
        killed = system.submit(kill)
        with pytest.raises(OutOfMemoryError, match="memory runs out"):
            asked(taken_over, what, b"import time\ntime.sleep(1000)")
        killed.result()


def test_only_processor_time_counts_against_a_task(taken_over: Sandbox, monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine refused good images for good: it had no processor for their tasks."""
    what = frames.MakePreview(**{**LIMITS, "cpu_s": 0.1}, max_bytes=100)
    with monkeypatch.context() as impatient, pytest.raises(SandboxUnavailableError, match="no processor"):
        impatient.setattr(client, "TIMEOUT_S", 1.0)
        asked(taken_over, what, b"import time\ntime.sleep(1000)")
    with pytest.raises(TaskError, match="time limit"):
        asked(taken_over, what, b"while True: pass")


def test_tasks_are_killed_before_the_service(taken_over: Sandbox) -> None:
    what = task()
    with begun(taken_over, WAITS, what):
        number = encoder_of(what.job_id)
        assert int(Path(f"/proc/{number}/oom_score_adj").read_text()) == int(confinement.OOM_SCORE)


def test_nonsense_is_the_end_of_its_task_alone(taken_over: Sandbox) -> None:
    for answer in ("bytes(8)", "bytes([18, 192, 0, 0]) * 2", "bytes([0, 0, 0, 2, 0, 0, 0, 0]) + b'[]'"):
        program = f"import os, time\nos.write(answer._descriptor, {answer})\ntime.sleep(1000)"
        what = task()
        with pytest.raises(FrameError):
            messages_of(taken_over, what, program.encode())
        wait_until(lambda what=what: encoder_of(what.job_id) is None)
        with pytest.raises(TaskError, match="crashed"):
            asked(taken_over, what, program.encode())


def test_nonsense_in_place_of_a_task_costs_itself(taken_over: Sandbox) -> None:
    """It ended the sandbox, and every task with it."""
    what = task()
    with begun(taken_over, WAITS, what) as running, file_of(b"") as file, socket.socket() as unconnected:
        for message in (b"", b"nonsense"):
            for things in ([], [file], [file, file], [unconnected], [unconnected, file]):
                socket.send_fds(taken_over._requests, [message], [thing.fileno() for thing in things])
        assert messages_of(taken_over, task(), b"pass")[-1] == Ended(status=0)
        end_early(encoder_of(what.job_id) or 0)
        assert list(until_end(running)) == [Ended(status=0)]


def test_a_client_that_reads_nothing_holds_up_no_other(taken_over: Sandbox) -> None:
    """Its task waits for it, and so does the word of its end; others are served."""
    program = b"for number in range(3000):\n    say(str(number))"
    with file_of(program) as file, taken_over.start(task(time_limit_s=100), file) as running:
        assert messages_of(taken_over, task(), b"pass")[-1] == Ended(status=0)
        *points, end = until_end(running)
        assert [point.phase for point in points] == [str(number) for number in range(3000)]
        assert end == Ended(status=0)
