"""Connected clients, by address, and which of them has been idle for longest."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Hashable
from typing import Generic, TypeVar

T = TypeVar("T", bound=Hashable)


class Crowd(Generic[T]):
    """Members, each of an address: quiet ones, who ask for nothing, and those who are being served.

    No call looks at all members: when there are too many, each that comes makes such a call. For the event loop alone.
    """

    def __init__(self) -> None:
        self._address_of: dict[T, str] = {}
        self._members_of: Counter[str] = Counter()
        # The quiet ones, quiet for longest first. An ordinary dict is slow to find its first once many have gone.
        self._quiet: OrderedDict[T, None] = OrderedDict()
        self._quiet_of: dict[str, OrderedDict[T, None]] = {}

    def size(self, address: str | None = None) -> int:
        """How many there are, of one address or in all."""
        return len(self._address_of) if address is None else self._members_of[address]

    def enter(self, member: T, address: str) -> None:
        """A new member, which is quiet."""
        self._address_of[member] = address
        self._members_of[address] += 1
        self.rest(member)

    def rest(self, member: T) -> None:
        """It is quiet from now on, unless it has left."""
        if (address := self._address_of.get(member)) is not None:
            self._quiet[member] = None
            self._quiet_of.setdefault(address, OrderedDict())[member] = None

    def stir(self, member: T) -> None:
        """It is quiet no longer."""
        if member in self._quiet:
            del self._quiet[member]
            address = self._address_of[member]
            del self._quiet_of[address][member]
            if not self._quiet_of[address]:
                del self._quiet_of[address]

    def leave(self, member: T) -> None:
        """It is gone, if it was there."""
        self.stir(member)
        address = self._address_of.pop(member, None)
        if address is not None:
            self._members_of[address] -= 1
            if not self._members_of[address]:
                del self._members_of[address]

    def quietest(self, address: str | None = None) -> T | None:
        """The client idle for longest, of one address or of all."""
        return next(iter(self._quiet if address is None else self._quiet_of.get(address, ())), None)
