"""A request to stop, made by a signal and seen by a loop."""

from __future__ import annotations

import os
import select
import signal


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
        """Sleep for `seconds`, or until stopping is requested. Returns whether it is."""
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
