"""Means and Markdown tables, for commands and for the pages of results."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence

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


def standard_error(values: Sequence[float]) -> float | None:
    """The standard error of the mean; None for fewer than two values."""
    return statistics.stdev(values) / math.sqrt(len(values)) if len(values) > 1 else None


def number(value: float | None, form: str) -> str:
    """Format a number, or return a dash for None. A negative number that rounds to zero has no sign."""
    if value is None:
        return MISSING
    rounded = format(value, form)
    return rounded if set(rounded) - set("+-0.,") else format(abs(value), form)
