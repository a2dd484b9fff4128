"""Options of the commands that take several values, separated by commas. Each is a type for argparse."""

from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Callable, Collection


def some_of(every: Collection[str], what: str, none: bool = False) -> Callable[[str], list[str]]:
    """Names of what there is, in the order in which they are given. none: an empty text is no name."""

    def named(text: str) -> list[str]:
        names = [] if none and not text else text.split(",")
        if unknown := {*names} - {*every}:
            raise ArgumentTypeError(f"{', '.join(sorted(unknown))}: no such {what}; there are {', '.join(every)}")
        return names

    return named


def numbers(text: str) -> list[float]:
    """Any."""
    return [float(word) for word in text.split(",")]


def integers(text: str) -> list[int]:
    """Whole ones."""
    return [int(word) for word in text.split(",")]
