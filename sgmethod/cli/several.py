"""Many conversions, one after the other or several at a time: a line for each, and one with the totals."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from threading import Lock
from typing import Any, TextIO

from sgmethod.cli import paths
from sgmethod.cli.arguments import one_line
from sgmethod.cli.naming import Conversion
from sgmethod.cli.paths import STREAM
from sgmethod.cli.terminal import Ticker, redraw, remaining, throughput_text
from sgmethod.many.manifest import Manifest
from sgmethod.many.processes import usual_jobs
from sgmethod.many.run import Finished, Run, Tally, Task, caught, finish_locally
from sgmethod.trace import TracePoint

SOME_FAILED = 1
Figures = dict[str, Any]


Convert = Callable[[Conversion, argparse.Namespace], Conversion]  # makes it


def say_notes(outcome: Conversion, arguments: argparse.Namespace) -> None:
    """Print what was dropped from a picture, and warnings about its file."""
    if not arguments.quiet:
        figures = outcome.figures
        paths.print_lines("note", outcome.input, outcome.notes)
        paths.print_lines("warning", outcome.input, figures.get("warnings", []))
        paths.print_lines("advice", outcome.input, filter(None, [figures.get("advice")]))


def convert_one(
    conversion: Conversion, convert: Convert, arguments: argparse.Namespace, others: Sequence[str] = ()
) -> int:
    """Make a single conversion unless --no-clobber keeps its output, and print its names and its summary.

    others: further outputs. If any is standard output, the text goes to stderr.
    """
    out = sys.stderr if STREAM in (conversion.target, *others) else sys.stdout
    for wanted in without_existing([conversion], arguments, out):
        with paths.contents_of(wanted.input):
            made = convert(wanted, arguments)
        say_notes(made, arguments)
        if getattr(arguments, "json", False):
            print(json.dumps(made.figures, allow_nan=False), file=out)
        elif not arguments.quiet:
            names = f"{paths.name_of(made.input)} -> {paths.name_of(made.target, 'standard output')}"
            print(f"{one_line(names)}: {made.summary}", file=out)
    return 0


def without_existing(conversions: list[Conversion], arguments: argparse.Namespace, out: TextIO) -> list[Conversion]:
    """Drop conversions whose output exists if --no-clobber is given, and say so."""
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
    """Print one line per finished conversion, a summary, and the failures, with exit status 1.

    Each also becomes a line of the manifest, if there is one; with --resume, those that it has are skipped.
    """
    beside = sys.stderr if getattr(arguments, "json", False) else sys.stdout  # with --json, stdout has nothing else
    kept = without_existing(conversions, arguments, beside)
    run = Run[Conversion](manifest, getattr(arguments, "resume", False), len(kept))
    wanted = list(run.rest(tasks_of(kept)))
    report = _Report([one.row.input for one in wanted], arguments)
    arguments.on_progress = report.advance if report.shows_progress else None
    try:
        tally = run.finish(outcomes(wanted, convert, arguments), report.show)
    except KeyboardInterrupt:
        resume = "; --resume continues" if manifest else ""
        raise KeyboardInterrupt(f"{report.done} of {len(wanted)} done{resume}") from None
    finally:
        report.end()
    if not arguments.quiet:
        counts = f"{tally.encoded} {verb}, {len(conversions) - len(wanted)} skipped, {tally.failed} failed"
        summary = f"{counts}: {tally.bytes:,} bytes, {time.perf_counter() - arguments.began:.1f} s"
        print(summary, file=beside, flush=True)
    for outcome in report.failed:
        print(f"sgmethod: {one_line(outcome.input)}: {one_line(outcome.error or '')}", file=sys.stderr)
    return SOME_FAILED if report.failed else 0


class _Report:
    """Printer of a line for each outcome, and of progress on a terminal, with the pictures that are being converted."""

    def __init__(self, pictures: list[str], arguments: argparse.Namespace) -> None:
        self.failed: list[Conversion] = []
        self.done = 0
        self._whole, self._arguments, self._json = len(pictures), arguments, getattr(arguments, "json", False)
        self._shown = not arguments.quiet and os.isatty(2)
        says_throughput = self._shown or not (arguments.quiet or self._json)
        self._says_throughput, self._throughput_text = says_throughput, ""
        self._left, self._jobs = Counter(pictures), jobs_of(arguments, pictures)
        self.shows_progress = self._shown and self._jobs == 1  # of a single picture, made in this process
        self._began: dict[str, float] = {}
        self._share = 0.0  # of the picture that is being converted
        self._lock = Lock()
        self._redraw()
        self._ticker = Ticker(self._tick) if self._shown else None

    def end(self) -> None:
        """Remove the progress from the terminal."""
        if self._ticker:
            self._ticker.end()
            redraw(sys.stderr, "")

    def advance(self, point: TracePoint) -> None:
        """Note the progress of the picture, which is drawn with the next tick."""
        self._share = max(self._share, point.share)

    def show(self, outcome: Conversion, tally: Tally) -> None:
        """Print a line for an outcome."""
        with self._lock:
            self._show(outcome, tally)

    def _show(self, outcome: Conversion, tally: Tally) -> None:
        done = self.done = tally.encoded + tally.failed
        self._left[outcome.input] -= 1  # -= of a Counter goes through all pictures
        if not self._left[outcome.input]:
            del self._left[outcome.input]
        self._share = 0.0
        if self._says_throughput:
            self._throughput_text = f", {throughput_text(tally.per_second)}{remaining(tally.seconds_left)}"
        if self._shown:
            redraw(sys.stderr, "")  # or the next line would follow it
        say_notes(outcome, self._arguments)
        if outcome.error:
            self.failed.append(outcome)
        elif self._json:
            names = {"input": outcome.input, "output": outcome.target}
            print(json.dumps({**names, **outcome.figures}, allow_nan=False), flush=True)
        elif not self._arguments.quiet:
            count = "" if self._shown else f" ({done} of {self._whole}{self._throughput_text})"
            print(f"{one_line(f'{outcome.input} -> {outcome.target}')}: {outcome.summary}{count}", flush=True)
        self._redraw()

    def _tick(self) -> None:
        with self._lock:
            self._redraw()

    def _redraw(self) -> None:
        """Draw the count and the pictures that are being converted: pictures are taken in order."""
        if self._shown and self.done < self._whole:
            now_s = time.perf_counter()
            running = [(name, now_s - self._began.setdefault(name, now_s)) for name in islice(self._left, self._jobs)]
            share = f" {self._share:.0%}" if self._share else ""
            names = ", ".join(f"{one_line(Path(name).name)}{share} {seconds:.0f} s" for name, seconds in running)
            redraw(sys.stderr, f"{self.done} of {self._whole}{self._throughput_text}: {names}")


def tasks_of(conversions: list[Conversion]) -> list[Task[Conversion]]:
    """Create a task for each conversion."""
    return [Task(one.input, one) for one in conversions]


def outcomes(tasks: list[Task[Conversion]], convert: Convert, arguments: argparse.Namespace) -> Finished[Conversion]:
    """Yield conversions as they are made."""
    make = partial(caught, partial(_converted, convert, arguments))
    return finish_locally(make, tasks, min(jobs_of(arguments, [task.row.input for task in tasks]), len(tasks)))


def jobs_of(arguments: argparse.Namespace, pictures: Sequence[str]) -> int:
    """Return how many pictures are converted at a time: those of a server, pipes and decodes, one after another.

    Other processes do not have the pipes of a shell's <(...).
    """
    if any(paths.is_device(picture) for picture in pictures):
        return 1
    is_remote = getattr(arguments, "server", None) is not None
    return getattr(arguments, "jobs", 1) or (1 if is_remote else usual_jobs(len(pictures)))


def _converted(convert: Convert, arguments: argparse.Namespace, task: Task[Conversion]) -> Conversion:
    return convert(task.row, arguments)
