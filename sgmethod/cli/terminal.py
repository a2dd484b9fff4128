"""Progress on a terminal, and silencing of C libraries."""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TextIO

from sgmethod.trace import share_of

if TYPE_CHECKING:
    from sgmethod.trace import Progress, TracePoint

BAR_CELLS = 24
FIRST_SHARE = 0.08  # of an encode; before it an estimate is far off


@contextmanager
def silent_stderr() -> Iterator[None]:
    """Discard what C libraries print to stderr; no other thread may print there meanwhile."""
    try:
        saved = os.dup(2)
    except OSError:  # there is no stderr
        yield
        return
    silence = os.open(os.devnull, os.O_WRONLY)
    sys.stderr.flush()
    os.dup2(silence, 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(silence)


@contextmanager
def progress_line(shown: bool, began: float) -> Iterator[Progress | None]:
    """Provide a callback that redraws one line on stderr; None if not shown. began: perf_counter at the start."""
    if not shown:
        yield None
        return
    try:
        redraw(sys.stderr, "start")  # reading and placing take seconds of a large picture
        yield lambda point: redraw(sys.stderr, bar(point, time.perf_counter() - began))
    finally:
        redraw(sys.stderr, "")


def redraw(stream: TextIO, text: str) -> None:
    """Replace the current line by a text, cut to the terminal's width."""
    columns = shutil.get_terminal_size().columns
    stream.write(f"\r{text[: columns - 1]}\x1b[K")  # go to the start of the line, print, clear the rest
    stream.flush()


def bar(point: TracePoint, waited_s: float) -> str:
    """Format the progress of a fit and the seconds waited. No PSNR, because tuning for the eye lowers it."""
    done = share_of(point.phase, point.step, point.steps)
    phase = "write" if point.phase == "done" else point.phase
    filled = round(done * BAR_CELLS)
    bar = "#" * filled + "." * (BAR_CELLS - filled)
    left = remaining(point.seconds, done) if done >= FIRST_SHARE else ""
    return f"{phase:<6} [{bar}] {done:4.0%}  {point.gaussians:,} Gaussians  {waited_s:.1f} s{left}"


def remaining(seconds: float, done: float) -> str:
    """Format the estimated time left, once there is something to estimate it from."""
    if not 0 < done < 1:
        return ""
    left = seconds * (1 - done) / done
    if left < 120:
        return f", {left:.0f} s left"
    return f", {left / 60:.0f} min left" if left < 7200 else f", {left / 3600:.0f} h left"
