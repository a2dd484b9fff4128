"""Command lines: parts of a command, and options that take several values, separated by commas."""

from __future__ import annotations

import sys
from argparse import ArgumentTypeError
from collections.abc import Callable, Collection, Mapping


def run_part(parts: Mapping[str, Callable[[], int | None]], doc: str, default: str = "") -> int:
    """Run the part that the first word names, or the default, with the words that follow. Returns its exit status."""
    name = sys.argv[1] if len(sys.argv) > 1 and not sys.argv[1].startswith("-") else default
    if name not in parts:
        is_help = bool({"-h", "--help"} & {*sys.argv})
        print(doc.strip(), file=sys.stdout if is_help else sys.stderr)
        return 0 if is_help else 2
    if len(sys.argv) > 1 and sys.argv[1] == name:
        del sys.argv[1]
    return parts[name]() or 0


def some_of(every: Collection[str], what: str, none: bool = False) -> Callable[[str], list[str]]:
    """Names from a known set, in the order in which they are given. none: an empty text is no name."""

    def named(text: str) -> list[str]:
        names = [] if none and not text else text.split(",")
        if unknown := {*names} - {*every}:
            raise ArgumentTypeError(f"{', '.join(sorted(unknown))}: no such {what}; there are {', '.join(every)}")
        return names

    return named


def numbers(text: str) -> list[float]:
    """Read numbers."""
    return [float(word) for word in text.split(",")]


def integers(text: str) -> list[int]:
    """Read whole numbers."""
    return [int(word) for word in text.split(",")]
