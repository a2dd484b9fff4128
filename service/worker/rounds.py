"""What a worker does beside its jobs, each in a thread of its own: it sweeps, gives signs of life, sends webhooks.

Its own thread may be busy with an encode for minutes, or wait for the storage, or for a job for days.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from service.jobs.table import JobTableError
from service.process.background import survived
from service.process.stopping import StopSignal


class Rounds(threading.Thread):
    """Does rounds until stopping is requested. Each that fails is followed by another.

    name: what is done, for the log; do: one round, which tells whether the next is to follow at once; pause_s: else
    seconds until then; at_end: what is done last.
    """

    def __init__(
        self,
        name: str,
        do: Callable[[], bool],
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
        with survived(self.name, JobTableError, OSError):
            return bool(step())
        return False
