"""Processes and how they end: loops that a signal stops and no exception ends, and the supervisor.

The supervisor runs the sandbox, the web process and the workers, restarts those that die, and stops them all together.
It opens the listening socket and passes it to the web process: while a dead web process is being replaced, connections
wait in the socket's queue and are not refused.
"""

from __future__ import annotations

import ipaddress
import logging
import os
import re
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from service.errors import JobTableError
from service.logs import log_seldom
from service.settings import Settings

log = logging.getLogger(__name__)

BACKLOG = 2048  # connections that the system holds until they are accepted; further clients try again after a second
WATCH_S = 0.1
FIRST_PAUSE_S = 0.2
MAX_PAUSE_S = 10.0
STEADY_AFTER_S = 10.0  # a process that lived this long did not fail at its start
# How often a process is looked at, and how many looks in a row find one still that hangs. Not seconds: a container that
# was paused does not hang.
LOOK_S, MAX_STILL_LOOKS = 1.0, 60


class StopSignal:
    """A request to stop, set by a signal handler or another thread, and awaited by the main loop.

    Not a threading.Event: its set() takes a lock that the interrupted wait() may hold.
    """

    def __init__(self) -> None:
        self._read_end, self._write_end = os.pipe()
        self.requested = False

    def request(self) -> None:
        """Ask the loop to end."""
        self.requested = True
        os.write(self._write_end, b"!")

    def wait(self, timeout_s: float) -> bool:
        """Sleep for timeout_s seconds, or until stopping is requested. Returns whether it is."""
        if not self.requested:
            select.select([self._read_end], [], [], timeout_s)
        return self.requested

    def on_signals(self) -> None:
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda _number, _frame: self.request())


@contextmanager
def log_errors(what: str) -> Iterator[None]:
    """Log any exception so that the loop continues.

    Wrap each round of a loop in it: a thread or task that an exception ends would otherwise end in silence.
    """
    try:
        yield
    except (JobTableError, OSError) as error:
        log_seldom(log, f"{what} has to wait: %s", error)
    except Exception:
        log.exception("%s failed unexpectedly and will be tried again", what)


class PeriodicThread(threading.Thread):
    """Repeats background work until stopping is requested, whatever a round raises.

    name: for the log; do: one round; pause_s: seconds between rounds; at_end: called last.
    """

    def __init__(
        self,
        name: str,
        do: Callable[[], None],
        pause_s: float,
        until: StopSignal,
        at_end: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(name=name, daemon=True)
        self._do = do
        self._pause_s = pause_s
        self._until = until
        self._at_end = at_end

    def run(self) -> None:
        self._run_logged(self._do)
        while not self._until.wait(self._pause_s):
            self._run_logged(self._do)
        self._run_logged(self._at_end)

    def _run_logged(self, step: Callable[[], None]) -> None:
        with log_errors(self.name):
            step()


class Pulse:
    """Tells whether a process of this service hangs. The main thread of each wakes up at least once a second."""

    def __init__(self, number: int) -> None:
        self._number = number
        self._switches: list[bytes] = []
        self._still_looks, self._next = 0, 0.0

    def has_stopped(self) -> bool:
        """Look, if it is time to. Whether the main thread has not run for MAX_STILL_LOOKS looks."""
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + LOOK_S
            with suppress(OSError):  # it has ended
                status = Path(f"/proc/{self._number}/status").read_bytes()
                before, self._switches = self._switches, re.findall(rb"ctxt_switches:\s*(\d+)", status)
                self._still_looks = self._still_looks + 1 if before == self._switches != [] else 0
        return self._still_looks >= MAX_STILL_LOOKS


class Supervised:
    """A process that is restarted when it dies or hangs, with growing pauses if it keeps dying."""

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        descriptors: Sequence[int],
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self.name = name
        self._command = command
        self._environment = environment
        self._descriptors = descriptors
        self._pause_s = FIRST_PAUSE_S
        self._start()

    def _start(self) -> None:
        self._started = time.monotonic()
        self._restart_at: float | None = None
        # A group of its own: Ctrl-C reaches the supervisor alone, which stops everything in order.
        self.process = subprocess.Popen(
            self._command, env=self._environment, stdin=subprocess.DEVNULL, pass_fds=self._descriptors, process_group=0
        )
        self._pulse = Pulse(self.process.pid)

    def keep_alive(self) -> None:
        """Restart the process if it is dead and its pause is over, and kill it if it hangs."""
        status = self.process.poll()
        if status is None:
            if self._pulse.has_stopped():
                log.error("%s hangs: killing it", self.name)
                self.process.kill()
        elif self._restart_at is None:
            self._start_later(f"ended ({status})")
        elif time.monotonic() >= self._restart_at:
            try:
                self._start()
            except OSError as error:  # as when the system has no memory or no process to spare
                self._start_later(f"cannot be started: {error}")

    def _start_later(self, why: str) -> None:
        now = time.monotonic()
        steady = now - self._started > STEADY_AFTER_S
        self._pause_s = FIRST_PAUSE_S if steady else min(2 * self._pause_s, MAX_PAUSE_S)
        self._restart_at = now + self._pause_s
        log.error("%s %s; next try in %.1f s", self.name, why, self._pause_s)

    def stop(self, deadline: float) -> None:
        """Wait until deadline (monotonic seconds) for the process to end, then kill it."""
        try:
            self.process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            log.error("%s did not stop in time: killing it", self.name)
            self.process.kill()
            self.process.wait()


def supervise(
    settings: Settings, listener: socket.socket, sandbox: Supervised, requests: socket.socket, stop: StopSignal
) -> None:
    """Run the web process and workers until stopping is requested. When this returns, they and the sandbox have ended.

    requests: socket for requests to the sandbox.
    """
    service, sockets = [sys.executable, "-m", "service"], (requests.fileno(), listener.fileno())
    names = ["--supervisor", str(os.getpid()), "--sandbox", str(requests.fileno())]
    clients = [Supervised("web process", [*service, "web", "--socket", str(listener.fileno()), *names], sockets)]
    for number in range(1, settings.workers + 1):
        clients.append(Supervised(f"worker {number}", [*service, "worker", *names], sockets[:1]))
    while not stop.wait(WATCH_S):
        for process in (sandbox, *clients):
            process.keep_alive()
    log.info("stopping")
    listener.close()
    for client in clients:
        client.process.terminate()
    deadline = time.monotonic() + settings.stop_grace_s
    for process in (*clients, sandbox):
        process.stop(deadline)


def listen(settings: Settings) -> socket.socket:
    """Open a listening socket at the host and port of the settings. Raises OSError, as when the port is in use."""
    is_v6 = ":" in settings.host
    family, both = (socket.AF_INET6 if is_v6 else socket.AF_INET), is_v6 and socket.has_dualstack_ipv6()
    try:  # `both`: "::" is IPv4 too, as for other servers
        return socket.create_server((settings.host, settings.port), family=family, backlog=BACKLOG, dualstack_ipv6=both)
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise OSError(f"SG_HOST and SG_PORT, {settings.host}:{settings.port}: {why}") from error


def url(listener: socket.socket) -> str:
    """Return the URL of the socket."""
    host, port = listener.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def is_loopback(listener: socket.socket) -> bool:
    """Whether only this machine can reach the socket."""
    return ipaddress.ip_address(listener.getsockname()[0]).is_loopback
