"""A header as a table of its fields, from which it is read and written.

docs/format.md, sgmethod/native/file/ and the page's decoder have the same tables; tests/native/decoder/test_fields.py
compares them.
"""

from __future__ import annotations

from dataclasses import dataclass

from sgmethod.errors import BitstreamError


@dataclass(frozen=True)
class Field:
    """A number without sign, its first byte the most significant: low to high, or one value besides."""

    name: str
    bytes: int
    low: int
    high: int
    also: int | None = None

    def allows(self, value: int) -> bool:
        """Whether a file may hold the value."""
        return self.low <= value <= self.high or value == self.also

    @property
    def range(self) -> str:
        """As docs/format.md writes it."""
        return ("" if self.also is None else f"{self.also}, ") + f"{self.low}..{self.high}"


@dataclass(frozen=True)
class Header:
    """Fields one after the other."""

    fields: tuple[Field, ...]

    @property
    def size(self) -> int:
        """In bytes."""
        return sum(f.bytes for f in self.fields)

    def read(self, data: memoryview | bytes) -> dict[str, int]:
        """The value of each field. Raises BitstreamError for one outside of its range, and where the data are short."""
        values, at = {}, 0
        for f in self.fields:
            if len(data) < at + f.bytes:
                raise BitstreamError("the file is truncated in its header")
            value = int.from_bytes(data[at : at + f.bytes], "big")
            if not f.allows(value):
                raise BitstreamError(f"header field {f.name} is {value}, outside {f.range}")
            values[f.name] = value
            at += f.bytes
        return values

    def write(self, values: dict[str, int]) -> bytes:
        """The bytes of a value for each field. Raises ValueError for one outside of its range."""
        for f in self.fields:
            if not f.allows(values[f.name]):
                raise ValueError(f"{f.name} = {values[f.name]} is outside {f.range}")
        return b"".join(values[f.name].to_bytes(f.bytes, "big") for f in self.fields)
