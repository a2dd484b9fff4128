"""The encoder process, which encodes one image, and the process that starts it: `service.worker.encoder DESCRIPTOR`.

Over the socket of that descriptor comes one line of JSON for each encode (see Spec), with three open files beside it:
the image, a pipe for frames, and one for what the encoder complains of. The process forks, and answers with the number
of its fork; so an encode does not wait until the codec is imported. The fork confines itself before it reads the image.
It is a child of the worker, which must be a subreaper.

An encoder knows neither the job table nor the storage. When it ends its memory is free again, and whatever an image
broke is gone. Once the first trace point is out, the signal END_EARLY asks it to stop fitting and to send what it has.

A frame is one letter, the payload's length (32 bits, big-endian) and the payload:
    T  a trace point (JSON)          any number of times
    P  a bitstream of what there is  now and then
    E  why the codec refused (text)  then nothing more
    R  the codec's figures (JSON)    then
    D  the bitstream                 the end
"""

from __future__ import annotations

import gc
import json
import math
import os
import resource
import signal
import socket
import struct
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import sgmethod
from service.jobs.job import EncodeRequest
from service.process import lifeline
from service.process.confinement import confine

READY = b"!"  # said once, when encoders can be started
PROCESS = struct.Struct(">I")  # the number of one
SPEC_BYTES = 1 << 16
FRAME_HEADER = struct.Struct(">cI")
TRACE, PREVIEW, REFUSED, STATS, BITSTREAM = b"T", b"P", b"E", b"R", b"D"

# What one line of a PPM file is enough for: the first encode of a process takes longer than those that follow.
TINY_PICTURE = b"P6 8 8 255 " + bytes(range(192))
NAME_LENGTH = 15  # of a process, which shows the beginning of its job's id
# Behind all who answer, so that answers come at once while every core encodes: the least share that the system gives.
NICENESS = 19
PARENT_GONE = 3
END_EARLY = signal.SIGUSR1
PREVIEW_EVERY_S = 1.0  # at most: each is written to the storage
NO_MEMORY = b"the encode exceeds the memory limit"


@dataclass(frozen=True)
class Spec:
    """What to do.

    job_id: for operators, who see it in the process list; folder: the encoder's own; lifeline: descriptor to watch;
    threads: of an encode; memory_bytes, cpu_s: limits of this process, the latter in seconds of one core.
    """

    job_id: str
    request: EncodeRequest
    folder: str
    lifeline: int
    threads: int
    memory_bytes: int
    cpu_s: int

    def to_json(self) -> bytes:
        """One line."""
        return json.dumps(asdict(self)).encode()

    @classmethod
    def from_json(cls, text: bytes) -> Spec:
        """The inverse of to_json."""
        fields = json.loads(text)
        return cls(**{**fields, "request": EncodeRequest(**fields["request"])})


def send(pipe: BinaryIO, kind: bytes, payload: bytes) -> None:
    """Write one frame."""
    pipe.write(FRAME_HEADER.pack(kind, len(payload)) + payload)
    pipe.flush()


def to_json(figures: dict[str, Any]) -> bytes:
    """Figures as JSON; a PSNR of infinity (a picture without error) becomes null, which JSON can say."""
    finite = {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in figures.items()}
    return json.dumps(finite, allow_nan=False).encode()


def limit_memory(limit_bytes: int) -> None:
    """Let allocations beyond the limit fail. A lower limit that holds already stays."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limit = limit_bytes if hard == resource.RLIM_INFINITY else min(limit_bytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


def limit_time(limit_s: int) -> None:
    """End this process after this much CPU time. The worker ends it before, unless it is stopped itself."""
    resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))


def _now_and_then(show: Callable[[bytes], None]) -> Callable[[bytes], None]:
    last = time.monotonic()

    def preview(file: bytes) -> None:
        nonlocal last
        if time.monotonic() - last >= PREVIEW_EVERY_S:
            last = time.monotonic()
            show(file)

    return preview


def encode_to(pipe: BinaryIO, request: EncodeRequest, source: bytes) -> None:
    """Encode the image and send the result."""
    stopped = threading.Event()
    signal.signal(END_EARLY, lambda *_: stopped.set())
    from sgmethod.budget import Budget
    from sgmethod.codec import encode
    from sgmethod.errors import ImageWarning, SgError
    from sgmethod.io.inputs import read_input

    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", ImageWarning)
            pixels = read_input(source, keep_alpha=request.profile == "rd")
            encoded = encode(
                pixels,
                Budget(request.budget_kind, request.budget_value),
                request.profile,
                tune=request.tune,
                effort=request.effort,
                time_limit_s=request.time_limit_s,
                on_progress=lambda point: send(pipe, TRACE, to_json(point.to_dict())),
                stop=stopped.is_set,
                on_preview=_now_and_then(lambda file: send(pipe, PREVIEW, file)),
                measure=True,
            )
            figures = _figures(encoded, pixels)
    except SgError as error:
        send(pipe, REFUSED, str(error).encode())
        return
    except MemoryError:  # another attempt would have no more of it
        send(pipe, REFUSED, NO_MEMORY)
        return
    notes = []
    for warning in caught:
        if issubclass(warning.category, ImageWarning):
            notes.append(str(warning.message))
        else:  # for the worker's log
            warnings.showwarning(warning.message, warning.category, warning.filename, warning.lineno)
    send(pipe, STATS, to_json({**figures, "source_bytes": len(source), **({"notes": notes} if notes else {})}))
    send(pipe, BITSTREAM, encoded.data)


def _figures(encoded: Any, pixels: Any) -> dict[str, Any]:
    """The codec's figures, with advice where another format suits the picture better."""
    from sgmethod.advice import advice, better_file

    size, db = len(encoded.data), encoded.stats.psnr
    return {**encoded.stats.to_dict(), "format": "sg", **advice(better_file(pixels, size, db), size, db)}


def encode_one(spec: Spec, source: int, frames: int, complaints: int) -> NoReturn:
    """What a fork does with the three descriptors: exit status 0 whenever an outcome was sent."""
    status = 1
    try:
        os.dup2(complaints, 1)  # what libraries print
        os.dup2(complaints, 2)
        Path("/proc/self/comm").write_text(spec.job_id[:NAME_LENGTH])
        os.environ["TMPDIR"] = spec.folder
        confine()
        lifeline.watch(spec.lifeline, lambda: os._exit(PARENT_GONE))
        limit_memory(spec.memory_bytes)
        limit_time(spec.cpu_s)
        os.nice(NICENESS)
        sgmethod.set_threads(spec.threads)
        with os.fdopen(source, "rb") as image, os.fdopen(frames, "wb") as pipe:
            encode_to(pipe, spec.request, image.read())
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(status)


def warm_up() -> None:
    """Import and set up what every encode needs. No thread may be left: a fork would not have it."""
    sgmethod.set_threads(1)
    from sgmethod.budget import Budget
    from sgmethod.codec import encode

    for tune in ("psnr", "visual"):
        encode(
            TINY_PICTURE,
            Budget("bpp", 8.0),
            "rd",
            tune=tune,
            effort=1,
            time_limit_s=0.1,
            on_progress=lambda _point: None,
            stop=lambda: False,
        )
    gc.collect()
    gc.freeze()  # so that forks share it


def fork_to_worker() -> int:
    """As os.fork(), but the new process, in a group of its own, is the worker's child: its parent has ended."""
    told, tell = os.pipe()
    between = os.fork()
    if between == 0:
        child = -1
        try:
            child = os.fork()
            if child:
                os.setpgid(child, child)
                os.write(tell, PROCESS.pack(child))
        finally:  # without a number the read below fails, and the worker sees this process end
            if child:
                os._exit(0)
        os.close(told)
        os.close(tell)
        return 0
    os.close(tell)
    os.waitpid(between, 0)
    with os.fdopen(told, "rb") as pipe:
        return int(PROCESS.unpack(pipe.read())[0])


def main() -> None:
    """Start encoders until the worker is gone."""
    worker = socket.socket(fileno=int(sys.argv[1]))
    warm_up()
    worker.sendall(READY)
    while True:
        line, descriptors, _, _ = socket.recv_fds(worker, SPEC_BYTES, 3)
        if not line:
            return
        child = fork_to_worker()
        if child == 0:
            worker.close()
            encode_one(Spec.from_json(line), *descriptors)
        worker.sendall(PROCESS.pack(child))
        for descriptor in descriptors:
            os.close(descriptor)


if __name__ == "__main__":
    main()
