"""Progress on a terminal, and silencing of C libraries."""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, TextIO

from sgmethod.trace import seconds_left

if TYPE_CHECKING:
    from sgmethod.trace import Progress, TracePoint

BAR_CELLS = 24
TICK_S = 1.0


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
    points: list[TracePoint] = []
    encode_began, lock = began, Lock()

    def draw() -> None:
        now = time.perf_counter()
        with lock:
            redraw(sys.stderr, bar(points, now - began, now - encode_began) if points else "start")

    def add(point: TracePoint) -> None:
        nonlocal encode_began
        points.append(point)
        encode_began = time.perf_counter() - point.seconds
        draw()

    draw()  # reading and placing take seconds of a large picture
    ticker = Ticker(draw)  # and so does a step
    try:
        yield add
    finally:
        ticker.end()
        redraw(sys.stderr, "")


class Ticker:
    """A thread that calls draw() every TICK_S until its end."""

    def __init__(self, draw: Callable[[], None]) -> None:
        self._draw, self._ended = draw, Event()
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Return once nothing is drawn any more."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(TICK_S):
            self._draw()


def redraw(stream: TextIO, text: str) -> None:
    """Replace the current line by a text, cut to the terminal's width."""
    columns = shutil.get_terminal_size().columns
    stream.write(f"\r{text[: columns - 1]}\x1b[K")  # go to the start of the line, print, clear the rest
    stream.flush()


def bar(trace: Sequence[TracePoint], waited_s: float, seconds: float) -> str:
    """Format the progress of a fit and the seconds waited. No PSNR, because tuning for the eye lowers it.

    seconds: since the encode began.
    """
    point, done = trace[-1], max(point.share for point in trace)
    left_s = seconds_left([trace[0].to_dict(), point.to_dict()], seconds) or None  # it takes longer than expected
    phase = "write" if point.phase == "done" else point.phase
    filled = round(done * BAR_CELLS)
    bar = "#" * filled + "." * (BAR_CELLS - filled)
    return f"{phase:<6} [{bar}] {done:4.0%}  {point.gaussians:,} Gaussians  {waited_s:.1f} s{remaining(left_s)}"


def remaining(left_s: float | None) -> str:
    """Format an estimate of the time left, if there is one."""
    if left_s is None:
        return ""
    if left_s < 120:
        return f", {left_s:.0f} s left"
    return f", {left_s / 60:.0f} min left" if left_s < 7200 else f", {left_s / 3600:.0f} h left"


def throughput_text(per_second: float) -> str:
    """Format a throughput as seconds a picture or, if they take less than one, as pictures a second."""
    if 0 < per_second < 1:
        return f"{1 / per_second:.3g} s a picture"
    return f"{per_second:{'.3g' if per_second < 100 else ',.0f'}} pictures/s"
