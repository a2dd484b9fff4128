"""Headers as tables of fields, which define both reading and writing.

docs/format.md and sgmethod/javascript/src/header.js have the same tables, which tests compare.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from sgmethod.errors import BitstreamError


@dataclass(frozen=True)
class BitField:
    """An unsigned integer of `bits` bits, most significant first.

    short_bits: the number of upper bits, at least half, that a short file has; they are repeated to give the lower
    ones. grows: the bits are a number n, n bits follow, and the value is 2^n plus these.
    """

    name: str
    bits: int
    short_bits: int
    grows: bool = False

    @property
    def low(self) -> int:
        """Least value."""
        return int(self.grows)

    @property
    def high(self) -> int:
        """Greatest value."""
        return int(2 ** (2**self.bits if self.grows else self.bits)) - 1

    def value(self, upper: int) -> int:
        """Value that these upper bits stand for in a short file."""
        return upper << (self.bits - self.short_bits) | upper >> (2 * self.short_bits - self.bits)

    def allows(self, value: int, is_short: bool) -> bool:
        """Whether a file may hold the value."""
        upper = value >> (self.bits - self.short_bits)
        return self.low <= value <= self.high and (not is_short or self.grows or self.value(upper) == value)


class BitReader:
    """A reader of consecutive fields, which end at a whole byte."""

    def __init__(self, data: memoryview | bytes) -> None:
        self._data, self._at = data, 0

    def _take(self, count: int) -> int:
        begin, end = self._at // 8, -(-(self._at + count) // 8)
        if end > len(self._data):
            raise BitstreamError("the file ends within its header")
        self._at += count
        return int.from_bytes(self._data[begin:end], "big") >> (8 * end - self._at) & ((1 << count) - 1)

    def read(self, fields: Iterable[BitField], is_short: bool) -> Iterator[int]:
        """Read each field. Raises BitstreamError for truncated data."""
        for f in fields:
            bits = f.short_bits if is_short else f.bits
            value = self._take(bits)
            if f.grows:
                value = 1 << value | self._take(value)
            yield f.value(value) if is_short and not f.grows else value

    def end(self) -> int:
        """Return the number of bytes read. Raises BitstreamError unless the bits after the last field are 0."""
        if self._take(-self._at % 8):
            raise BitstreamError("the padding of the file's header is not zero")
        return self._at // 8


def write_bits(values: Iterable[tuple[BitField, int]], is_short: bool) -> bytes:
    """Write fields for BitReader. Raises ValueError for a value that a file cannot hold."""
    bits = ""
    for f, value in values:
        if not f.allows(value, is_short):
            raise ValueError(f"a file cannot hold {f.name} = {value}")
        width = f.short_bits if is_short else f.bits
        if f.grows:
            n = value.bit_length() - 1
            bits += f"{n:0{width}b}" + f"{value:b}"[1:]
        else:
            bits += f"{value >> (f.bits - width):0{width}b}"
    bits += "0" * (-len(bits) % 8)
    return int(bits, 2).to_bytes(len(bits) // 8, "big")
