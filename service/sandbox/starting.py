"""Starts the sandbox and keeps it alive; its clients' socket outlives it."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import threading
import time
from collections.abc import Iterator

from service.process.supervisor import WATCH_S, Supervised
from service.sandbox.confinement import absent_layers, environment

MODULE = "service.sandbox.server"
THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS")
ENDS_S = 2.0
# A fork begins with no memory of its own: in pages of 2 MB, the picture of 768x512 takes 800 page faults, not 2,000.
HUGE_PAGES = {"GLIBC_TUNABLES": "glibc.malloc.hugetlb=1"}


class SandboxProcess(Supervised):
    """The process of the sandbox. requests: the socket into which its clients write.

    What they write while it is dead is done by its successor. threads: of an encode.
    """

    def __init__(self, threads: int) -> None:
        self.requests, self._served = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        # Libraries read these when they are loaded. OpenBLAS's threads would be lost in forks.
        variables = {**dict.fromkeys(THREAD_VARIABLES, str(threads)), "OPENBLAS_NUM_THREADS": "1"}
        number = self._served.fileno()
        command = [sys.executable, "-m", MODULE, str(number)]
        super().__init__("sandbox", command, (number,), {**HUGE_PAGES, **environment(os.environ), **variables})

    def stop(self, deadline: float) -> None:
        """Let it end, as it does once all its clients are gone."""
        self.requests.close()
        self._served.close()
        super().stop(deadline)


@contextlib.contextmanager
def own_sandbox(threads: int) -> Iterator[socket.socket]:
    """The requests of a sandbox that is this process's own, and ends with the context."""
    process, ended = SandboxProcess(threads), threading.Event()

    def keep() -> None:
        while not ended.wait(WATCH_S):
            process.keep_alive()

    keeper = threading.Thread(target=keep, name="sandbox", daemon=True)
    keeper.start()
    try:
        yield process.requests
    finally:
        ended.set()
        keeper.join()
        process.stop(time.monotonic() + ENDS_S)


class SandboxError(Exception):
    """The sandbox lacks a layer that must not be missing; one sentence."""


def check_layers(*, required: bool) -> list[str]:
    """Sentences on what the system does not offer, and on root. Raises SandboxError if a layer that is required is
    missing.
    """
    absent = " and ".join(absent_layers())
    if absent and required:
        raise SandboxError(f"SG_REQUIRE_SANDBOX is set, and this system does not offer {absent}")
    missing = [f"uploads are read without {absent}, which this system does not offer"] if absent else []
    return missing + ["the service runs as root; what reads uploads runs as nobody"] * (os.geteuid() == 0)
