"""A sandbox of a test's own, in which one task does what the test says."""

from __future__ import annotations

import io
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import BinaryIO

from service.jobs.job import new_job_id
from service.sandbox.client import MODULE, RunningTask, Sandbox
from service.sandbox.confinement import environment
from service.sandbox.frames import Encode, Message, Task, TracePoint
from tests.support.data import ROOT
from tests.support.job_table import request_of
from tests.support.processes import TIMEOUT_S, wait_until

# In place of an encode or a preview, a program in the file runs where the codec would: confined, with `answer` at hand,
# and say() for words of up to 20 characters, which arrive as the phase of a trace point.
TAKEN_OVER = """
import ctypes, json, mmap, os, resource, signal, socket, sys, threading, time  # which a program cannot import any more
from service.sandbox import confinement, frames, server, tasks

def run(task, file, answer):
    zeros = dict.fromkeys(("seconds", "step", "steps", "psnr", "bytes", "gaussians", "share"), 0)
    say = lambda words: answer.send(frames.TracePoint(**zeros, phase=words))
    exec(file.decode(), {"task": task, "answer": answer, "say": say})

tasks.PERFORM[frames.Encode] = tasks.PERFORM[frames.MakePreview] = run

"""
# Such a program, until tests.support.processes.end_early() ends it.
WAITS = b"""
import signal, time
asked = []
signal.signal(signal.SIGUSR1, lambda *_: asked.append(1))
while not asked:
    time.sleep(0.01)
"""


@contextmanager
def sandbox(
    preamble: str = "", extra: Mapping[str, str] | None = None, absent: Sequence[str] = ()
) -> Iterator[tuple[Sandbox, int]]:
    """A sandbox and the number of its process, which runs the preamble first. absent: layers that tasks may lack."""
    requests, served = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    program = ["-c", f"{preamble}\nfrom service.sandbox import server\nserver.main()"] if preamble else ["-m", MODULE]
    command = [sys.executable, *program, str(served.fileno()), "json", "0", *absent]
    known = {**environment(os.environ), "OPENBLAS_NUM_THREADS": "1", **(extra or {})}
    known["PYTHONPATH"] = os.pathsep.join(filter(None, (str(ROOT), known.get("PYTHONPATH", ""))))
    with requests:
        with served:
            process = subprocess.Popen(command, cwd="/", env=known, pass_fds=(served.fileno(),), process_group=0)
        try:
            yield Sandbox(requests), process.pid
        finally:
            requests.close()
            try:
                process.wait(TIMEOUT_S)
            finally:
                process.kill()
                process.wait()


def task(time_limit_s: float = 0.1, **more: object) -> Encode:
    """An encode of a small picture."""
    limits = {"memory_bytes": 2**31, "cpu_s": 600, "max_pixels": 10_000, "threads": 1, **more}
    request = request_of(time_limit_s=time_limit_s)
    return Encode(job_id=new_job_id(), request=request, **limits)  # type: ignore[arg-type]


@contextmanager
def file_of(data: bytes) -> Iterator[BinaryIO]:
    """An open file of these bytes."""
    with tempfile.TemporaryFile() as file:
        file.write(data)
        file.flush()
        file.seek(0, io.SEEK_END)  # a task reads it from its beginning all the same
        yield file


@contextmanager
def begun(sandbox: Sandbox, program: bytes, what: Task | None = None) -> Iterator[RunningTask]:
    """A task, an encode by default, that runs a program, from when it has begun."""
    with file_of(program) as file, sandbox.start(what or task(), file) as running:
        wait_until(lambda: running.read(0.1) or running.begun)
        yield running


def messages_of(sandbox: Sandbox, encode: Encode, data: bytes) -> list[Message]:
    """All that an encode says, up to its end. Raises FrameError."""
    with file_of(data) as file, sandbox.start(encode, file) as running:
        return list(until_end(running))


def until_end(running: RunningTask) -> Iterator[Message]:
    """What a task says, up to the message that ends it."""
    while True:
        for message in running.read(1.0):
            yield message
            if not isinstance(message, TracePoint):
                return
