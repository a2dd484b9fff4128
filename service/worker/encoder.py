"""The encoder process, which encodes one image: `service.worker.encoder SPEC`, started confined by a worker.

It knows neither the job table nor the storage. SPEC is a JSON object (see Spec). The image comes in as standard
input, and everything goes out as frames on standard output. When the process ends its memory is free again, and
whatever an image broke is gone. Once the first trace point is out, the signal END_EARLY asks it to stop fitting and to
send what it has.

A frame is one letter, the payload's length (32 bits, big-endian) and the payload:
    T  a trace point (JSON)          any number of times
    P  a bitstream of what there is  now and then
    E  why the codec refused (text)  then nothing more
    R  the codec's figures (JSON)    then
    D  the bitstream                 the end
"""

from __future__ import annotations

import json
import math
import os
import resource
import signal
import struct
import sys
import threading
import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, BinaryIO

from service.jobs.job import EncodeRequest
from service.process import lifeline

FRAME_HEADER = struct.Struct(">cI")
TRACE, PREVIEW, REFUSED, STATS, BITSTREAM = b"T", b"P", b"E", b"R", b"D"

# Behind all who answer, so that answers come at once while every core encodes: the least share that the system gives.
NICENESS = 19
PARENT_GONE = 3
END_EARLY = signal.SIGUSR1
PREVIEW_EVERY_S = 1.0  # at most: each is written to the storage
NO_MEMORY = b"the encode exceeds the memory limit"


@dataclass(frozen=True)
class Spec:
    """What to do. job_id and attempt are there for operators, who see them in the process list.

    lifeline: descriptor to watch; memory_bytes, cpu_s: limits of this process, the latter in seconds of one core.
    """

    job_id: str
    attempt: int
    request: EncodeRequest
    lifeline: int
    memory_bytes: int
    cpu_s: int

    def to_json(self) -> str:
        """The spec as a command-line argument."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Spec:
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


def take_standard_output() -> BinaryIO:
    """A private copy of standard output; what libraries print goes to standard error from now on."""
    pipe = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return pipe


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

    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", ImageWarning)
            encoded = encode(
                source,
                Budget(request.budget_kind, request.budget_value),
                request.profile,
                tune=request.tune,
                effort=request.effort,
                time_limit_s=request.time_limit_s,
                on_progress=lambda point: send(pipe, TRACE, to_json(point.to_dict())),
                stop=stopped.is_set,
                on_preview=_now_and_then(lambda file: send(pipe, PREVIEW, file)),
            )
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
    send(pipe, STATS, to_json(encoded.stats.to_dict() | ({"notes": notes} if notes else {})))
    send(pipe, BITSTREAM, encoded.data)


def main() -> None:
    """Run one encode; exit status 0 whenever an outcome was sent."""
    spec = Spec.from_json(sys.argv[1])
    lifeline.watch(spec.lifeline, lambda: os._exit(PARENT_GONE))
    limit_memory(spec.memory_bytes)
    limit_time(spec.cpu_s)
    os.nice(NICENESS)
    pipe = take_standard_output()
    encode_to(pipe, spec.request, sys.stdin.buffer.read())


if __name__ == "__main__":
    main()
