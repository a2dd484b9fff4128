"""Rules that the rows of one picture and seed keep.

Each is a function over those rows. For every row that it speaks of it says by how much the row is on the wrong side,
0 at best; its line in RULES has the unit of that, and how much of it is allowed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from benchmarks.robustness.stiff.rows import Row

Found = Iterator[tuple[Row, float]]


@dataclass(frozen=True)
class Rule:
    """How far a row may be on the wrong side of a rule, and in which unit."""

    find: Callable[[Sequence[Row]], Found]
    tolerance: float
    unit: str


@dataclass(frozen=True)
class Check:
    """One row under one rule."""

    rule: str
    row: Row
    by: float

    @property
    def broken(self) -> bool:
        """Whether the row is too far on the wrong side."""
        return self.by > RULES[self.rule].tolerance


def failed(rows: Sequence[Row]) -> Found:
    """An encode ends with a file, or correctly reports that the budget is too small for one."""
    smallest = min((row.size for row in with_file(rows)), default=None)
    for row in rows:
        wrongly = row.refused is not None and smallest is not None and smallest <= row.most
        yield row, float(row.error is not None or wrongly)


def falls(rows: Sequence[Row]) -> Found:
    """A file is no worse than one of fewer bytes."""
    group = of_kind("bpp", rows)
    for row in group:
        yield row, max((other.db - row.db for other in group if other.size < row.size), default=0.0)


def exceeded(rows: Sequence[Row]) -> Found:
    """A file does not exceed its budget."""
    for row in of_kind("bpp", rows):
        yield row, float(row.size - row.most)


def missed(rows: Sequence[Row]) -> Found:
    """A target PSNR is reached if any file of the picture reaches it."""
    for row in of_kind("psnr", rows):
        if any(other.db >= row.value for other in with_file(rows)):
            yield row, row.value - row.db


def clipped(rows: Sequence[Row]) -> Found:
    """Every number in a file is finite, and none is clipped."""
    for row in with_file(rows):
        yield row, float(row.clipped)


def trace(rows: Sequence[Row]) -> Found:
    """A file is no worse than its trace showed at that size, or has the target PSNR."""
    for row in with_file(rows):
        if row.traced is not None:
            enough = row.exact or (row.kind == "psnr" and row.db >= row.value)
            yield row, 0.0 if enough else row.traced[1] - row.db


def with_file(rows: Sequence[Row]) -> list[Row]:
    """Those whose encode ended with a file."""
    return [row for row in rows if row.bytes is not None]


def of_kind(kind: str, rows: Sequence[Row]) -> list[Row]:
    """Those with a file that had a budget of one kind."""
    return [row for row in with_file(rows) if row.kind == kind]


RULES = {
    "failed": Rule(failed, 0, "errors"),
    "falls": Rule(falls, 0.5, "dB"),
    "exceeded": Rule(exceeded, 0, "bytes"),
    "missed": Rule(missed, 0, "dB"),
    "clipped": Rule(clipped, 0, "numbers"),
    "trace": Rule(trace, 0.1, "dB"),
}


def judge(rows: Sequence[Row]) -> list[Check]:
    """Every check of every rule, in the order of RULES."""
    groups: dict[tuple[str, int], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.picture, row.seed), []).append(row)
    found = ((name, rule.find(group)) for name, rule in RULES.items() for group in groups.values())
    return [Check(name, row, max(by, 0.0)) for name, checks in found for row, by in checks]
