"""Many conversions, one after the other or several at a time: a line for each, and one with the totals."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Generator, Iterable
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from sgmethod.cli import files
from sgmethod.cli.arguments import one_line
from sgmethod.cli.files import STREAM, CommandError
from sgmethod.cli.naming import Conversion
from sgmethod.cli.terminal import redraw, remaining
from sgmethod.errors import SgError

if TYPE_CHECKING:
    from sgmethod.many.manifest import Manifest

SOME_FAILED = 1
Figures = dict[str, Any]


@dataclass(frozen=True)
class Outcome:
    """The result of one conversion: the size of its file and a summary, or an error."""

    conversion: Conversion
    bytes: int = 0
    said: str = ""
    figures: Figures = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    error: str = ""


Convert = Callable[[Conversion, argparse.Namespace], Outcome]


def say_notes(outcome: Outcome, arguments: argparse.Namespace) -> None:
    """Print what was dropped from a picture, and warnings about its file."""
    if not arguments.quiet:
        source = outcome.conversion.source
        files.print_lines("note", source, outcome.notes)
        files.print_lines("warning", source, outcome.figures.get("warnings", []))  # older servers have none
        files.print_lines("advice", source, filter(None, [outcome.figures.get("advice")]))


def say_done(outcome: Outcome, out: TextIO) -> None:
    """Print the names and the summary of a single conversion."""
    source, target = outcome.conversion.source, outcome.conversion.target
    names = f"{files.name_of(source)} -> {files.name_of(target, 'standard output')}"
    print(f"{one_line(names)}: {outcome.said}", file=out)


def without_those_there(conversions: list[Conversion], arguments: argparse.Namespace, out: TextIO) -> list[Conversion]:
    """With --no-clobber, drop conversions whose output exists, and say so."""
    kept = []
    for one in conversions:
        if arguments.no_clobber and one.target != STREAM and Path(one.target).is_file():
            if not arguments.quiet:
                print(f"{one_line(one.target)} already exists: skipped", file=out)
        else:
            kept.append(one)
    return kept


def convert_all(
    conversions: list[Conversion],
    convert: Convert,
    verb: str,
    arguments: argparse.Namespace,
    manifest: Manifest | None = None,
) -> int:
    """Print one line per finished conversion, a summary, and the failures, with exit status 1. With a manifest, add a
    line there for each, and with --resume skip those that it has."""
    wanted = without_those_there(conversions, arguments, _beside(arguments))
    keys: dict[Conversion, str] = {}
    if manifest is not None:
        keys = {one: manifest.key(one.source) for one in wanted}
        if arguments.resume:
            wanted = [one for one in wanted if not manifest.has(Path(one.target).name, keys[one])]
    finished = outcomes(wanted, convert, arguments)
    if manifest is not None:
        finished = _noted(finished, manifest, keys)
    with closing(finished):
        failed, sizes = _report(finished, len(wanted), arguments)
    if not arguments.quiet:
        counts = f"{len(sizes)} {verb}, {len(conversions) - len(wanted)} skipped, {len(failed)} failed"
        said = f"{counts}: {sum(sizes):,} bytes, {time.perf_counter() - arguments.began:.1f} s"
        print(said, file=_beside(arguments), flush=True)
    for outcome in failed:
        print(f"sgmethod: {one_line(outcome.conversion.source)}: {one_line(outcome.error)}", file=sys.stderr)
    return SOME_FAILED if failed else 0


def _beside(arguments: argparse.Namespace) -> TextIO:
    """Where text goes: with --json, stdout has nothing else."""
    return sys.stderr if getattr(arguments, "json", False) else sys.stdout


def _report(finished: Iterable[Outcome], whole: int, arguments: argparse.Namespace) -> tuple[list[Outcome], list[int]]:
    """Print a line for each outcome, and progress on a terminal. Returns the failures, and the sizes of the others."""
    began, done = time.perf_counter(), 0
    failed, sizes = [], []
    shown = not arguments.quiet and os.isatty(2)
    _show_count(shown, 0, whole, "")
    try:
        for outcome in finished:
            done += 1
            seconds = time.perf_counter() - began
            pace = f", {done / seconds:.3g} pictures/s{remaining(seconds, done / whole)}"
            if shown:
                redraw(sys.stderr, "")  # or what is said would stand behind it
            say_notes(outcome, arguments)
            if outcome.error:
                failed.append(outcome)
            else:
                sizes.append(outcome.bytes)
                names = {"input": outcome.conversion.source, "output": outcome.conversion.target}
                if getattr(arguments, "json", False):
                    print(json.dumps({**names, **outcome.figures}, allow_nan=False), flush=True)
                elif not arguments.quiet:
                    count = "" if shown else f" ({done} of {whole}{pace})"
                    print(f"{one_line(' -> '.join(names.values()))}: {outcome.said}{count}", flush=True)
            _show_count(shown, done, whole, pace)
    finally:
        if shown:
            redraw(sys.stderr, "")
    return failed, sizes


def _show_count(shown: bool, done: int, whole: int, pace: str) -> None:
    if shown and done < whole:
        redraw(sys.stderr, f"{done} of {whole}{pace}")


def _noted(
    finished: Generator[Outcome, None, None], manifest: Manifest, keys: dict[Conversion, str]
) -> Generator[Outcome, None, None]:
    """The outcomes, each with its line in the manifest."""
    from sgmethod.many.manifest import Row

    with closing(finished):
        for outcome in finished:
            one = outcome.conversion
            row = Row(Path(one.target).name, one.source, outcome.bytes, outcome.figures, outcome.notes, key=keys[one])
            manifest.add(replace(row, error=outcome.error or None))
            yield outcome


def outcomes(
    conversions: list[Conversion], convert: Convert, arguments: argparse.Namespace
) -> Generator[Outcome, None, None]:
    """The outcomes, as they finish."""
    attempt = partial(_attempt, convert, arguments)
    jobs = min(getattr(arguments, "jobs", 1), len(conversions))
    if jobs <= 1:
        yield from map(attempt, conversions)
        return
    from sgmethod.many.processes import KILLED, in_processes

    with closing(in_processes(attempt, conversions, jobs)) as finished:
        for conversion, outcome in finished:
            yield outcome or Outcome(conversion, error=KILLED)


def _attempt(convert: Convert, arguments: argparse.Namespace, conversion: Conversion) -> Outcome:
    try:
        return convert(conversion, arguments)
    except MemoryError:
        return Outcome(conversion, error="out of memory")
    except (SgError, CommandError) as error:
        return Outcome(conversion, error=str(error))
