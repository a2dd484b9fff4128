"""Rules that the rows of one picture and seed keep.

Each is a function over those rows. For every row that it concerns, it says by how much the row is on the wrong side,
0 at best; its line in RULES has the unit of that, and how much of it is allowed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.robustness.stiff.rows import EXACT_DB, Row
from benchmarks.tables import MISSING

Found = Iterator[tuple[Row, float]]


@dataclass(frozen=True)
class Rule:
    """How far a row may be on the wrong side of a rule, and in which unit. The function's docstring is the rule."""

    find: Callable[[Sequence[Row]], Found]
    tolerance: float
    unit: str


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
            enough = row.db == EXACT_DB or (row.kind == "psnr" and row.db >= row.value)
            yield row, 0.0 if enough else row.traced[1] - row.db


def with_file(rows: Sequence[Row]) -> list[Row]:
    """The rows whose encode ended with a file."""
    return [row for row in rows if row.bytes is not None]


def of_kind(kind: str, rows: Sequence[Row]) -> list[Row]:
    """The rows with a file that had a budget of one kind."""
    return [row for row in with_file(rows) if row.kind == kind]


RULES = (
    Rule(failed, 0, "errors"),
    Rule(falls, 0.5, "dB"),
    Rule(exceeded, 0, "bytes"),
    Rule(missed, 0, "dB"),
    Rule(clipped, 0, "numbers"),
    Rule(trace, 0.1, "dB"),
)


def judged(rows: Sequence[Row]) -> Iterator[list[Any]]:
    """For each rule: its words, its tolerance, the checks, those that fail, and the worst of them."""
    groups: dict[tuple[str, int], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.picture, row.seed), []).append(row)
    for rule in RULES:
        checks = [check for group in groups.values() for check in rule.find(group)]
        broken = [check for check in checks if check[1] > rule.tolerance]
        worst = MISSING
        if broken:
            row, by = max(broken, key=lambda check: check[1])
            worst = f"{by:.3g} {rule.unit} ({row.picture}, {row.kind} {row.value:g})"
        says = (rule.find.__doc__ or "").rstrip(".")
        yield [says, f"{rule.tolerance:g} {rule.unit}", len(checks), len(broken), worst]
