"""Fair shares of what there is only so much of."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from starlette.types import Scope

from service.web.guards.problems import ProblemError

RETRY_AFTER = {"Retry-After": "5"}


class Shares:
    """So much of a thing, of which one client has half at most.

    most: of all together; reason: the word for it in figures and logs; what: there is too much of, as it follows "too
    many". For the event loop alone.
    """

    def __init__(self, most: int, reason: str, what: str) -> None:
        self._most = most
        self._own_most = -(-most // 2)
        self.reason = reason
        self._what = what
        self._taken: Counter[str] = Counter()

    def total(self) -> int:
        """How much all clients have now."""
        return self._taken.total()

    def refusal(self, client: str, more: int = 1) -> ProblemError | None:
        """Why the client cannot have so much more: 503 if there is not so much left, 429 if its own part is used up."""
        if self.total() + more > self._most:
            return ProblemError(503, f"too many {self._what}", reason=self.reason, headers=RETRY_AFTER)
        if self._taken[client] + more > self._own_most:
            detail = f"too many {self._what}, of yours alone"
            return ProblemError(429, detail, reason=f"own_{self.reason}", headers=RETRY_AFTER)
        return None

    def check(self, client: str, more: int = 1) -> None:
        """Raises ProblemError 503 or 429."""
        if (refusal := self.refusal(client, more)) is not None:
            raise refusal

    def take(self, client: str, amount: int = 1) -> None:
        """Count it, whether or not it was checked: the size of an answer is known too late."""
        self._taken[client] += amount

    def give_back(self, client: str, amount: int = 1) -> None:
        """Undo take."""
        self._taken[client] -= amount
        if not self._taken[client]:
            del self._taken[client]

    @contextmanager
    def taken(self, client: str, amount: int = 1) -> Iterator[None]:
        """Taken as long as the context."""
        self.take(client, amount)
        try:
            yield
        finally:
            self.give_back(client, amount)


def client_of(scope: Scope) -> str:
    """The caller, once the gate has seen the request."""
    caller = scope.get("state", {}).get("caller")
    return "" if caller is None else str(caller.client)
