"""The worker's side of encoder processes: start one, read its frames, end it."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import signal
import time
from dataclasses import dataclass
from types import TracebackType

from service.jobs.job import JsonObject
from service.worker.encoder import BITSTREAM, END_EARLY, FRAME_HEADER, PREVIEW, REFUSED, STATS, TRACE

READ_BYTES = 1 << 16
COMPLAINTS_BYTES = 4096  # the last of them
SILENT_S = 1.0
MAX_LAST_WORDS = 300  # characters of an error that a client gets to read
MAX_FRAME_BYTES = 1 << 29  # a file of the largest image that is read takes 300 MB at most


@dataclass(frozen=True)
class TracePoint:
    """How far the fit is."""

    point: JsonObject


@dataclass(frozen=True)
class Preview:
    """A bitstream of what there is so far."""

    bitstream: bytes


@dataclass(frozen=True)
class Refused:
    """The codec refused the image or the budget, with one sentence."""

    detail: str


@dataclass(frozen=True)
class Encoded:
    """The encode is done."""

    stats: JsonObject
    bitstream: bytes


@dataclass(frozen=True)
class Crashed:
    """The encoder process ended without an outcome, or its source image was gone; one sentence."""

    detail: str


@dataclass(frozen=True)
class TimedOut:
    """The encoder process ran for longer than limit_s, the limit of the settings."""

    limit_s: float


Outcome = Encoded | Refused | Crashed | TimedOut
Message = TracePoint | Preview | Refused | Encoded


class EncoderProcess:
    """An encoder process in a group of its own. Leaving the context kills the whole group.

    number: of the process, a child of this one; frames, complaints: where it writes, two pipes' reading ends.
    """

    def __init__(self, number: int, frames: int, complaints: int) -> None:
        self.number = number
        self._output = bytearray()
        self._complaints = bytearray()
        self._stats: JsonObject = {}
        self._listens = False  # to the signal that ends it early, as it does once it fits
        self._selector = selectors.DefaultSelector()
        self._pipes = (frames, complaints)
        for pipe, read in zip(self._pipes, (self._output, self._complaints), strict=True):
            os.set_blocking(pipe, False)
            self._selector.register(pipe, selectors.EVENT_READ, read)

    def __enter__(self) -> EncoderProcess:
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        # Until it is waited for, the system gives the group's number to no other group, even if the process is dead.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.number, signal.SIGKILL)
        with contextlib.suppress(ChildProcessError):
            while True:  # what it has started is a child of the worker too, now that its own parent is gone
                os.waitpid(-self.number, 0)
        self._selector.close()
        for pipe in self._pipes:
            os.close(pipe)

    @property
    def ended(self) -> bool:
        """Whether the encoder process has closed its pipes, so that nothing more will come."""
        return not self._selector.get_map()

    def read(self, timeout_s: float) -> list[Message]:
        """The messages that have come in. Waits timeout_s seconds at most for one to come.

        Raises ValueError if the encoder process writes something other than frames.
        """
        for key, _ in self._selector.select(timeout_s):
            data = os.read(key.fd, READ_BYTES)
            if not data:
                self._selector.unregister(key.fileobj)
            key.data.extend(data)
        del self._complaints[:-COMPLAINTS_BYTES]
        return self._take_messages()

    def end_early(self) -> None:
        """Ask it, once it fits, to end soon with what it has. To ask again changes nothing."""
        if self._listens:
            os.kill(self.number, END_EARLY)

    def last_words(self) -> str:
        """One sentence on how the encoder process ended, once it has closed its pipes without an outcome."""
        deadline = time.monotonic() + SILENT_S
        while (ended := os.waitid(os.P_PID, self.number, os.WEXITED | os.WNOHANG | os.WNOWAIT)) is None:
            if time.monotonic() > deadline:
                return "the encoder fell silent"
            time.sleep(0.01)
        exited, status = ended.si_code == os.CLD_EXITED, ended.si_status
        how = f"exit status {status}" if exited else signal.strsignal(status)
        lines = self._complaints.decode(errors="replace").strip().splitlines()
        words = f": {lines[-1].strip()[:MAX_LAST_WORDS]}" if lines and exited and status else ""
        return f"the encoder crashed ({how}){words}"

    def _take_messages(self) -> list[Message]:
        messages: list[Message] = []
        while len(self._output) >= FRAME_HEADER.size:
            kind, length = FRAME_HEADER.unpack_from(self._output)
            if length > MAX_FRAME_BYTES:
                raise ValueError(f"a frame of {length} bytes")
            end = FRAME_HEADER.size + length
            if len(self._output) < end:
                break
            payload = bytes(self._output[FRAME_HEADER.size : end])
            del self._output[:end]
            if kind == TRACE:
                self._listens = True
                messages.append(TracePoint(json.loads(payload)))
            elif kind == PREVIEW:
                messages.append(Preview(payload))
            elif kind == REFUSED:
                messages.append(Refused(payload.decode()))
            elif kind == STATS:
                self._stats = json.loads(payload)
            elif kind == BITSTREAM:
                messages.append(Encoded(self._stats, payload))
            else:
                raise ValueError(f"a frame of unknown kind {kind!r}")
        return messages
