"""The web process's side of helper processes: started when needed, kept for the next errand, ended with one."""

from __future__ import annotations

import asyncio
import json
import math
import os
import signal
import socket
import subprocess
from typing import Any, BinaryIO

from anyio import CapacityLimiter, to_thread

from service.process import confinement
from service.web.helpers.helper import ANSWER_HEADER, READY, Errand
from sgmethod import errors

PROGRAM = "service.web.helpers.helper"
# An errand ends its process when it has had its seconds of a core. This is for a machine without any to spare.
PATIENCE_S = 60.0
Json = dict[str, Any]
TRIES = 2  # a helper may have died of something else than its errand


class HelperError(Exception):
    """An errand came to nothing through no fault of the service: one sentence."""


class TooMuchError(HelperError):
    """The errand takes more memory or time than it may."""


class RefusedError(HelperError):
    """The file, or what is wished of it, was refused. kind: the class of the error, of sgmethod.errors."""

    def __init__(self, kind: type[Exception], detail: str) -> None:
        super().__init__(detail)
        self.kind = kind


class _EndedError(Exception):
    """The helper ended before it answered."""


class _Helper:
    """One helper process, ready when it is made. Methods block; kill may be called meanwhile from another thread."""

    def __init__(self) -> None:
        self._ours, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                confinement.command(PROGRAM, str(theirs.fileno())),
                env={**confinement.environment(os.environ), "OPENBLAS_NUM_THREADS": "1"},
                stdin=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),),
                process_group=0,
            )
        self._ours.recv(len(READY))  # nothing of one that ended, which the first errand will say

    def ask(self, errand: Errand, file: BinaryIO) -> tuple[Json, bytes]:
        """Figures and a picture file. Raises _EndedError."""
        try:
            socket.send_fds(self._ours, [errand.to_json()], [file.fileno()])
            with self._ours.makefile("rb") as answer:
                head = answer.read(ANSWER_HEADER.size)
                if len(head) < ANSWER_HEADER.size:
                    raise _EndedError
                text_bytes, picture_bytes = ANSWER_HEADER.unpack(head)
                text, picture = answer.read(text_bytes), answer.read(picture_bytes)
        except ConnectionError:
            raise _EndedError from None
        if len(picture) < picture_bytes:
            raise _EndedError
        return json.loads(text), picture

    def kill(self) -> int:
        """End it; how it ended, as Popen.returncode says it."""
        self._process.kill()
        self._ours.shutdown(socket.SHUT_RDWR)  # for a thread that still waits
        self._ours.close()
        return self._process.wait()

    @property
    def alive(self) -> bool:
        """Whether it can take an errand."""
        return self._process.poll() is None


class Helpers:
    """Helper processes, one per concurrent errand. The caller limits their number, by turns."""

    def __init__(self) -> None:
        self._idle: list[_Helper] = []
        self._threads = CapacityLimiter(math.inf)

    async def ask(self, errand: Errand, file: BinaryIO) -> tuple[Json, bytes]:
        """Figures and a picture file. When the caller is cancelled, its helper ends with it.

        Raises RefusedError, TooMuchError, HelperError.
        """
        for _ in range(TRIES):
            helper = await self._take()
            try:
                answer = await asyncio.wait_for(self._asked(helper, errand, file), PATIENCE_S)
            except _EndedError:
                if await self._end(helper) == -signal.SIGPROF:
                    raise TooMuchError("it exceeds the time limit") from None
                continue
            except BaseException as error:
                await self._end(helper)
                if isinstance(error, TimeoutError):
                    raise TooMuchError("it exceeds the time limit") from None
                raise
            self._idle.append(helper)
            return _judged(*answer)
        raise HelperError("its decoder crashed")

    async def _asked(self, helper: _Helper, errand: Errand, file: BinaryIO) -> tuple[Json, bytes]:
        return await to_thread.run_sync(helper.ask, errand, file, abandon_on_cancel=True, limiter=self._threads)

    async def _take(self) -> _Helper:
        while self._idle:
            helper = self._idle.pop()
            if helper.alive:
                return helper
            helper.kill()
        return await to_thread.run_sync(_Helper, limiter=self._threads)

    async def _end(self, helper: _Helper) -> int:
        """End it, and start another within the turn of the client whose errand it was, so that no other has to wait."""
        status = await to_thread.run_sync(helper.kill, limiter=self._threads)
        self._idle.append(await to_thread.run_sync(_Helper, limiter=self._threads))
        return status

    def close(self) -> None:
        """End those that have nothing to do."""
        while self._idle:
            self._idle.pop().kill()


def _judged(figures: Json, picture: bytes) -> tuple[Json, bytes]:
    if "refused" not in figures:
        return figures, picture
    kind: type[Exception] = getattr(errors, figures["refused"], MemoryError)
    if kind is MemoryError:
        raise TooMuchError(figures["detail"])
    raise RefusedError(kind, figures["detail"])
