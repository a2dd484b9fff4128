"""The road between a worker and its encoder process, with processes that misbehave."""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from service.jobs.job import EncodeRequest, new_job_id
from service.process.lifeline import Lifeline
from service.process.stopping import StopSignal
from service.worker.encoder import Spec, send, to_json
from service.worker.encoder_process import Encoded, EncoderProcess, Message, Refused, TracePoint
from service.worker.starting import PROGRAM, Encoders
from tests.harness.data import ROOT
from tests.harness.pictures import SMALL
from tests.harness.processes import processes, wait_until
from tests.harness.service import STAND_IN

PREAMBLE = "import os, sys, time; from service.worker.encoder import send; out = sys.stdout.buffer\n"


@contextmanager
def child(script: str) -> Iterator[EncoderProcess]:
    """A process that runs the script where the encoder would run."""
    frames, complaints = os.pipe(), os.pipe()
    number = os.posix_spawn(
        sys.executable,
        [sys.executable, "-c", PREAMBLE + script],
        {**os.environ, "PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}"},
        file_actions=[(os.POSIX_SPAWN_DUP2, pipe[1], to) for to, pipe in ((1, frames), (2, complaints))],
        setpgroup=0,
    )
    for pipe in (frames, complaints):
        os.close(pipe[1])
    with EncoderProcess(number, frames[0], complaints[0]) as process:
        yield process


@pytest.fixture
def lifeline() -> Iterator[Lifeline]:
    lifeline = Lifeline()
    yield lifeline
    with contextlib.suppress(OSError):
        lifeline.close()


@pytest.fixture
def encoders(lifeline: Lifeline) -> Iterator[Encoders]:
    """Starts encoders that have a stand-in for the codec."""
    encoders = Encoders({**os.environ, **STAND_IN}, lifeline.read_end)
    assert encoders.get_ready(StopSignal())
    yield encoders
    encoders.close()


def spec(lifeline: Lifeline, folder: object, time_limit_s: float) -> Spec:
    request = EncodeRequest("bpp", 1.0, "rd", time_limit_s)
    return Spec(new_job_id(), request, str(folder), lifeline.read_end, 1, 2**33, 600)


def messages_of(process: EncoderProcess) -> list[Message]:
    messages: list[Message] = []
    while not process.ended:
        messages += process.read(1.0)
    return messages


def test_frames_arrive_whole_and_in_order() -> None:
    script = """
send(out, b"T", b'{"step": 1}')
data = b"D\\x00\\x03\\x0d\\x40" + bytes(200_000)
for at in range(0, len(data), 1000):  # a frame in many pieces, larger than a pipe
    out.write(data[at : at + 1000])
    out.flush()
"""
    with child("send(out, b'R', b'{\"bytes\": 3}')\n" + script) as process:
        first, second = messages_of(process)
    assert first == TracePoint({"step": 1})
    assert second == Encoded({"bytes": 3}, bytes(200_000))


def test_encoders_start_one_after_the_other(encoders: Encoders, lifeline: Lifeline, tmp_path: Path) -> None:
    """Each is a process of its own, and reads the image it is given from its beginning."""
    image = tmp_path / "image"
    image.write_bytes(SMALL)
    seen = set()
    for _ in range(2):
        with image.open("rb") as source, encoders.start(spec(lifeline, tmp_path, 0.1), source) as process:
            seen.add(process.number)
            *points, outcome = messages_of(process)
        assert all(isinstance(point, TracePoint) for point in points)
        assert isinstance(outcome, Encoded)
        assert outcome.stats["bytes"] == len(outcome.bitstream)
    assert len(seen) == 2
    assert not seen & set(processes())


def starter() -> int:
    """The process that starts encoders."""
    ours = {number: process for number, process in processes().items() if process.parent == os.getpid()}
    (number,) = (n for n, p in ours.items() if PROGRAM in p.command and not p.is_a("encoder"))
    return number


@pytest.mark.usefixtures("encoders")
def test_what_starts_encoders_has_no_thread() -> None:
    """A fork would lack it, and wait for it for ever."""
    assert len([*Path("/proc", str(starter()), "task").iterdir()]) == 1


@pytest.mark.thorough
def test_what_starts_encoders_is_started_again(encoders: Encoders, lifeline: Lifeline, tmp_path: Path) -> None:
    """Its end does no harm to an encoder that runs, and the next one has to wait only until it is back."""
    image = tmp_path / "image"
    image.write_bytes(SMALL)
    with image.open("rb") as source, encoders.start(spec(lifeline, tmp_path, 100), source) as process:
        number = starter()
        os.kill(number, signal.SIGKILL)
        wait_until(lambda: number not in processes())
        with pytest.raises(OSError, match=r"has died|roken pipe"):
            encoders.start(spec(lifeline, tmp_path, 100), source)
        wait_until(lambda: process.read(1.0))
        process.end_early()
        wait_until(lambda: any(isinstance(message, Encoded) for message in process.read(1.0)))
    assert encoders.get_ready(StopSignal())
    with image.open("rb") as source, encoders.start(spec(lifeline, tmp_path, 0.1), source) as process:
        assert isinstance(messages_of(process)[-1], Encoded)


def test_one_that_is_to_end_early() -> None:
    script = """
import signal
stopped = []
signal.signal(signal.SIGUSR1, lambda *_: stopped.append(True))
send(out, b"T", b'{"step": 1}')
while not stopped:
    time.sleep(0.01)
send(out, b"D", b"early")
"""
    with child(script) as process:
        process.end_early()  # before it listens the signal would be its end
        assert wait_until(lambda: process.read(1.0)) == [TracePoint({"step": 1})]
        process.end_early()
        process.end_early()
        assert messages_of(process) == [Encoded({}, b"early")]
        assert process.last_words() == "the encoder crashed (exit status 0)"


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("sys.exit(7)", "the encoder crashed (exit status 7)"),
        ("raise MemoryError('too much')", "the encoder crashed (exit status 1): MemoryError: too much"),
        ("os.kill(os.getpid(), 11)", "the encoder crashed (Segmentation fault)"),
        ("os.close(1); os.close(2); time.sleep(60)", "the encoder fell silent"),
        ("sys.stderr.write('x' * 100_000); sys.exit(1)", "the encoder crashed (exit status 1): " + "x" * 300),
    ],
)
def test_last_words(script: str, words: str) -> None:
    with child(script) as process:
        assert messages_of(process) == []
        assert process.last_words() == words


@pytest.mark.parametrize("frame", ["b'Z' + bytes(4)", "b'T' + bytes([255] * 4)", "b'T' + bytes([0, 0, 0, 1]) + b'{'"])
def test_nonsense(frame: str) -> None:
    with child(f"out.write({frame})") as process, pytest.raises(ValueError, match=r"frame|Expecting"):
        messages_of(process)


def sleeps() -> bool:
    return any(process.command == "sleep 1234567 " for process in processes().values())


def test_leaving_kills_the_whole_group() -> None:
    script = """
import subprocess
subprocess.Popen(["sleep", "1234567"])
send(out, b"E", str(os.getpid()).encode())
time.sleep(60)
"""
    with child(script) as process:
        (message,) = wait_until(lambda: process.read(1.0))
        assert isinstance(message, Refused)
        wait_until(sleeps)  # a program that has just begun has no command line for a moment
    assert int(message.detail) not in processes()
    wait_until(lambda: not sleeps())


def test_the_encoder_ends_with_its_worker(encoders: Encoders, lifeline: Lifeline, tmp_path: Path) -> None:
    """Rule 4: the pipe ends, the encoder ends, even while it waits for its image."""
    source, never_written = os.pipe()
    with os.fdopen(source, "rb") as image, encoders.start(spec(lifeline, tmp_path, 100), image) as process:
        wait_until(lambda: processes()[process.number].is_a("encoder"))
        lifeline.close()
        assert messages_of(process) == []
        assert process.last_words() == "the encoder crashed (exit status 3)"
    os.close(never_written)


def test_spec_survives_the_way() -> None:
    spec = Spec("0" * 32, EncodeRequest("psnr", 30.5, "baseline", 2.5), "/tmp/x", 7, 2, 10**9, 600)
    assert Spec.from_json(spec.to_json()) == spec


def test_figures_that_json_cannot_say_become_null() -> None:
    figures = {"psnr": float("inf"), "ssim": float("nan"), "bytes": 3, "profile": "paper"}
    assert json.loads(to_json(figures)) == {"psnr": None, "ssim": None, "bytes": 3, "profile": "paper"}


def test_a_frame() -> None:
    pipe = io.BytesIO()
    send(pipe, b"T", b"xy")
    assert pipe.getvalue() == b"T\x00\x00\x00\x02xy"


def test_signals_have_names_for_operators() -> None:
    with child("time.sleep(60)") as process:
        os.kill(process.number, signal.SIGTERM)
        assert messages_of(process) == []
        assert process.last_words() == "the encoder crashed (Terminated)"
