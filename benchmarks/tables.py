"""Means and Markdown tables, for commands and for the pages of results."""

from __future__ import annotations

import math
import statistics
from collections import defaultdict
from collections.abc import Hashable, Sequence

MISSING = "-"


def table(titles: str, rows: Sequence[Sequence[object]]) -> str:
    """Markdown; titles separated by bars."""
    names = [title.strip() for title in titles.split("|")]
    head = ["| " + " | ".join(names) + " |", "|" + "---|" * len(names)]
    return "\n".join([*head, *("| " + " | ".join(map(str, row)) + " |" for row in rows)])


def mean(values: Sequence[float | None]) -> float | None:
    """None where there is no value, or one is missing."""
    known = [value for value in values if value is not None]
    return statistics.fmean(known) if known and len(known) == len(values) else None


def standard_error(values: Sequence[float], groups: Sequence[Hashable] | None = None) -> float | None:
    """The standard error of the mean; None for fewer than two values, or groups.

    groups: of each value, where those of one group are alike, such as photographs from one source: the error is
    clustered by them.
    """
    of = range(len(values)) if groups is None else groups
    sums: dict[Hashable, float] = defaultdict(float)
    for value, group in zip(values, of, strict=True):
        sums[group] += value - statistics.fmean(values)
    if len(sums) < 2:
        return None
    return math.sqrt(math.fsum(one**2 for one in sums.values()) * len(sums) / (len(sums) - 1)) / len(values)


def number(value: float | None, form: str) -> str:
    """Format a number, or return a dash for None. A negative number that rounds to zero has no sign."""
    if value is None:
        return MISSING
    rounded = format(value, form)
    return rounded if set(rounded) - set("+-0.,") else format(abs(value), form)
