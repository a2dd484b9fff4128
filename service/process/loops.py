"""What loops need: a request to stop, made by a signal, and rounds that go on whatever happens to one of them."""

from __future__ import annotations

import logging
import os
import select
import signal
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from service.errors import JobTableError
from service.logs import log_seldom

log = logging.getLogger(__name__)

failures: Counter[str] = Counter()  # of this process, by what has failed; /metrics shows their sum


class StopSignal:
    """Set by a signal handler or another thread, waited for by the main loop.

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
        """Sleep for that many seconds, or until stopping is requested. Returns whether it is."""
        if not self.requested:
            select.select([self._read_end], [], [], timeout_s)
        return self.requested

    def fileno(self) -> int:
        """A descriptor that can be read from once stopping is requested, for loops that wait for descriptors."""
        return self._read_end

    def on_signals(self) -> None:
        """Let SIGTERM and SIGINT make the request."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda _number, _frame: self.request())


@contextmanager
def survived(what: str) -> Iterator[None]:
    """Log an exception, so that the thread or task goes on with its next round; one that nobody foresaw is counted.

    Wrap one round of a loop in it. A thread or task that ends by an exception otherwise ends in silence.
    """
    try:
        yield
    except (JobTableError, OSError) as error:
        log_seldom(log, f"{what} has to wait: %s", error)
    except Exception:
        failures[what] += 1
        log.exception("%s failed unexpectedly and will be tried again", what)


class Rounds(threading.Thread):
    """Background work in rounds, until stopping is requested. Each that fails is followed by another.

    name: what is done, for the log; do: one round, which tells whether the next is to follow at once; pause_s: else
    seconds until then; at_end: what is done last.
    """

    def __init__(
        self,
        name: str,
        do: Callable[[], bool | None],
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
        while not self._until.wait(0.0 if self._survived(self._do) else self._pause_s):
            pass
        self._survived(self._at_end)

    def _survived(self, step: Callable[[], bool | None]) -> bool:
        with survived(self.name):
            return bool(step())
        return False
