"""Starts encoder processes: the worker's side of the process that has the codec in memory and forks."""

from __future__ import annotations

import ctypes
import logging
import os
import select
import socket
import subprocess
import sys
from collections.abc import Mapping
from typing import BinaryIO

from service.process.stopping import StopSignal
from service.worker.encoder import PROCESS, READY, Spec
from service.worker.encoder_process import EncoderProcess
from service.worker.heartbeat import PAUSE_AFTER_TROUBLE_S

log = logging.getLogger(__name__)

PROGRAM = "service.worker.encoder"
SET_CHILD_SUBREAPER = 36  # include/uapi/linux/prctl.h


class Encoders:
    """One encoder process after the other, each a fork of one that never sees an image.

    environment: all that they know of; lifeline: the descriptor to hand down. For one thread.
    """

    def __init__(self, environment: Mapping[str, str], lifeline: int) -> None:
        self._environment = {**environment, "OPENBLAS_NUM_THREADS": "1"}  # others would be lost in forks
        self._lifeline = lifeline
        self._process: subprocess.Popen[bytes] | None = None

    def get_ready(self, stop: StopSignal) -> bool:
        """Wait until encoders can be started at once; False if stopping is requested before. Starts the process that
        starts them if there is none, or it has died.
        """
        while not stop.requested:
            if self._process is not None and self._process.poll() is None:
                return True
            if self._begin(stop):
                return True
            if not stop.requested:
                log.error("no encoder can be started; next try in %.0f s", PAUSE_AFTER_TROUBLE_S)
                stop.wait(PAUSE_AFTER_TROUBLE_S)
        return False

    def _begin(self, stop: StopSignal) -> bool:
        self.close()
        # So that encoders are this process's children, though another forks them.
        ctypes.CDLL(None).prctl(SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        self._ours, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", PROGRAM, str(theirs.fileno())],
                env=self._environment,
                stdin=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(), self._lifeline),
                process_group=0,
            )
        select.select([self._ours.fileno(), stop.fileno()], [], [])
        return not stop.requested and self._ours.recv(len(READY)) == READY

    def start(self, spec: Spec, source: BinaryIO) -> EncoderProcess:
        """A new encoder, which reads the open image. Raises OSError, as when the process that starts them is gone."""
        frames, its_frames = os.pipe()
        complaints, its_complaints = os.pipe()
        try:
            socket.send_fds(self._ours, [spec.to_json()], [source.fileno(), its_frames, its_complaints])
            answer = self._ours.recv(PROCESS.size)
            if not answer:
                raise ConnectionError("the process that starts encoders has died")
        except OSError:
            os.close(frames)
            os.close(complaints)
            self.close()
            raise
        finally:
            os.close(its_frames)
            os.close(its_complaints)
        return EncoderProcess(PROCESS.unpack(answer)[0], frames, complaints)

    def close(self) -> None:
        """End the process that starts encoders."""
        if self._process is not None:
            self._ours.close()
            self._process.kill()
            self._process.wait()
            self._process = None
