"""The road between a worker and its encoder process, with processes that misbehave."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from service.jobs.job import EncodeRequest
from service.process import confinement
from service.process.lifeline import Lifeline
from service.worker.encoder import Spec, send, to_json
from service.worker.encoder_process import Encoded, EncoderProcess, Message, Refused, TracePoint
from tests.harness.data import ROOT
from tests.harness.pictures import SMALL
from tests.harness.processes import PATIENCE_S, processes, wait_until

PREAMBLE = "import os, sys, time; from service.worker.encoder import send; out = sys.stdout.buffer\n"


@contextmanager
def child(script: str, source: bytes = b"") -> Iterator[EncoderProcess]:
    """A process that runs the script where the encoder would run."""
    lifeline = Lifeline()
    command = [sys.executable, "-c", PREAMBLE + script]
    with tempfile.TemporaryFile() as file:
        file.write(source)
        file.seek(0)
        environment = {**os.environ, "PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}"}
        with EncoderProcess(command, file, environment, lifeline.read_end) as process:
            yield process
    lifeline.close()


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


def test_the_source_is_standard_input() -> None:
    with child("send(out, b'D', sys.stdin.buffer.read()[::-1])", source=SMALL) as process:
        assert messages_of(process) == [Encoded({}, SMALL[::-1])]


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


def test_the_encoder_ends_with_its_parent() -> None:
    """Rule 4: the pipe ends, the encoder ends, even while it waits for its image."""
    lifeline = Lifeline()
    spec = Spec("0" * 32, 1, EncodeRequest("bpp", 1.0, "paper", 60.0), lifeline.read_end, 2**33, 600)
    command = confinement.command("service.worker.encoder", spec.to_json())
    with subprocess.Popen(
        command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, pass_fds=(lifeline.read_end,)
    ) as process:
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(1.0)
        lifeline.close()
        assert process.wait(PATIENCE_S) == 3


def test_spec_survives_the_command_line() -> None:
    spec = Spec("0" * 32, 3, EncodeRequest("psnr", 30.5, "baseline", 2.5), 7, 10**9, 600)
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
        os.kill(process._process.pid, signal.SIGTERM)
        assert messages_of(process) == []
        assert process.last_words() == "the encoder crashed (Terminated)"
