"""Many conversions, one after the other or several at a time: a line for each, and one with the totals."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from sgmethod.cli import files
from sgmethod.cli.arguments import one_line
from sgmethod.cli.files import STREAM, CommandError
from sgmethod.cli.naming import Conversion
from sgmethod.cli.terminal import redraw, remaining
from sgmethod.errors import SgError

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

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


def convert_all(conversions: list[Conversion], convert: Convert, verb: str, arguments: argparse.Namespace) -> int:
    """Print one line per finished conversion, a summary, and the failures, with exit status 1."""
    as_json = getattr(arguments, "json", False)
    beside = sys.stderr if as_json else sys.stdout  # stdout has nothing but JSON then
    wanted = without_those_there(conversions, arguments, beside)
    began, done = time.perf_counter(), 0
    failed, sizes = [], []
    shown = not arguments.quiet and os.isatty(2)
    _show_count(shown, 0, len(wanted), "")
    try:
        for outcome in _outcomes(wanted, convert, arguments):
            done += 1
            left = remaining(time.perf_counter() - began, done / len(wanted))
            if shown:
                redraw(sys.stderr, "")  # or what is said would stand behind it
            say_notes(outcome, arguments)
            if outcome.error:
                failed.append(outcome)
            else:
                sizes.append(outcome.bytes)
                names = {"input": outcome.conversion.source, "output": outcome.conversion.target}
                if as_json:
                    print(json.dumps({**names, **outcome.figures}, allow_nan=False), flush=True)
                elif not arguments.quiet:
                    count = "" if shown else f" ({done} of {len(wanted)}{left})"
                    print(f"{one_line(' -> '.join(names.values()))}: {outcome.said}{count}", flush=True)
            _show_count(shown, done, len(wanted), left)
    finally:
        if shown:
            redraw(sys.stderr, "")
    if not arguments.quiet:
        counts = f"{len(sizes)} {verb}, {len(conversions) - len(wanted)} skipped, {len(failed)} failed"
        said = f"{counts}: {sum(sizes):,} bytes, {time.perf_counter() - arguments.began:.1f} s"
        print(said, file=beside, flush=True)
    for outcome in failed:
        print(f"sgmethod: {one_line(outcome.conversion.source)}: {one_line(outcome.error)}", file=sys.stderr)
    return SOME_FAILED if failed else 0


def _show_count(shown: bool, done: int, whole: int, left: str) -> None:
    if shown and done < whole:
        redraw(sys.stderr, f"{done} of {whole}{left}")


def _outcomes(conversions: list[Conversion], convert: Convert, arguments: argparse.Namespace) -> Iterator[Outcome]:
    """The outcomes, as they finish."""
    jobs = min(getattr(arguments, "jobs", 1), len(conversions))
    if jobs <= 1:
        yield from (_attempt(convert, conversion, arguments) for conversion in conversions)
        return
    import signal
    from multiprocessing import get_context

    from sgmethod.native import native

    threads = max(native.thread_count() // jobs, 1)
    context = get_context("spawn")  # a copy of this process would have its threads' locks and not its threads
    with ProcessPoolExecutor(jobs, context, _begin_worker, (threads,)) as pool:
        # Ctrl-C is for this process alone. The others inherit that they ignore it: they may not even have begun Python.
        interrupted = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            running = {pool.submit(_attempt, convert, conversion, arguments): conversion for conversion in conversions}
        finally:
            signal.signal(signal.SIGINT, interrupted)
        try:
            for future in as_completed(running):
                try:
                    yield future.result()
                except BrokenProcessPool:
                    yield Outcome(running[future], error="its encoder process, or another, was killed")
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            from multiprocessing import active_children

            for child in active_children():
                child.terminate()
            raise


def _begin_worker(threads: int) -> None:
    """Set up a worker process: it ends with its parent, and ignores Ctrl-C."""
    import signal
    from multiprocessing import parent_process
    from threading import Thread

    from sgmethod.native import native

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Windows lets nothing be inherited
    parent = parent_process()
    if parent is not None:
        Thread(target=_end_with, args=(parent,), daemon=True).start()
    native.set_thread_count(threads)


def _end_with(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


def _attempt(convert: Convert, conversion: Conversion, arguments: argparse.Namespace) -> Outcome:
    try:
        return convert(conversion, arguments)
    except MemoryError:
        return Outcome(conversion, error="out of memory")
    except (SgError, CommandError) as error:
        return Outcome(conversion, error=str(error))
