"""How many responses may stay open: streams of events, and requests that wait for a job."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from service.web.guards.problems import ProblemError

RETRY_AFTER = {"Retry-After": "5"}


class Streams:
    """Counts what is open. For the event loop alone."""

    def __init__(self, most: int) -> None:
        self._most = most
        self.open = 0

    @property
    def full(self) -> bool:
        """Whether no more may be opened."""
        return self.open >= self._most

    @contextmanager
    def one(self) -> Iterator[None]:
        """Open as long as the context. Raises ProblemError 503 if there are too many."""
        if self.full:
            raise ProblemError(503, "too many streams of events are open", reason="streams", headers=RETRY_AFTER)
        self.open += 1
        try:
            yield
        finally:
            self.open -= 1
