"""Loops that a signal stops, and that no exception ends."""

from __future__ import annotations

import logging
import os
import select
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from service.errors import JobTableError
from service.logs import log_seldom

log = logging.getLogger(__name__)


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
