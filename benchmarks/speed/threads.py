"""Measure which stages of an encode do not scale with the threads.

    python -m benchmarks.speed threads [--images FOLDER] [--cases small,large,default] [--threads 1,2,4,8,16]
                                       [--repeats 5] [--tune psnr] [--out FILE]

Cases: 0.4 and 9.4 megapixels at 0.25 bits per pixel, and 9.4 megapixels into 50 kB. Encodes take turns with each number
of threads, and the table has medians. A stage is the time within some functions, without that of stages within them;
"rest" is all others. What does not scale is the part s that explains a stage's times t with the fewest and the most
threads: t_n = s + (t_1 - s) / n. The times with 8 and 16 threads follow from these parts. Others that use the machine
make everything seem not to scale.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import wraps
from itertools import product
from pathlib import Path
from pkgutil import resolve_name
from threading import get_ident
from typing import Any
from unittest.mock import patch

from benchmarks.arguments import integers, some_of
from benchmarks.machine import RUNS, Record
from benchmarks.pictures import Pixels, chosen_from, sized
from benchmarks.tables import table
from sgmethod import encode, set_threads
from sgmethod.native import native
from tests.support.data import PHOTOGRAPHS

# Where a stage's functions are looked up when they are called.
STAGES = {
    "steps": ["sgmethod.backend.kernels.Kernels.steps"],
    "refine": ["sgmethod.backend.kernels.Kernels.refine"],
    "colours of new Gaussians": ["sgmethod.fitting.level.Level.solve_colors"],
    "places of new Gaussians": ["sgmethod.rd.densify.candidates"],
    "residual": ["sgmethod.backend.kernels.Kernels.residual"],
    "error": ["sgmethod.backend.kernels.Kernels.error", "sgmethod.fitting.objective.Objective.error"],
    "rounding": ["sgmethod.backend.kernels.Kernels.rounded"],
    "coding": ["sgmethod.bitstream.v2.StreamV2.from_gaussians"],
    "pruning": ["sgmethod.rd.encode.prune", "sgmethod.rd.encode.prune_to_limit"],
    "moving target": ["sgmethod.fitting.moving_target.ExaggeratedTarget.moved"],
    "texture": ["sgmethod.fitting.texture.grain", "sgmethod.fitting.texture.estimate"],
    "objective": ["sgmethod.fitting.objective.Objective.from_pixels", "sgmethod.fitting.objective.Histogram"],
    "start": ["sgmethod.rd.encode.pyramid_of", "sgmethod.rd.encode.place"],
    "measuring": ["sgmethod.codec.measured"],
}
REST, WHOLE = "rest", "whole"
THREADS, MANY = (1, 2, 4, 8, 16), (8, 16)  # measured where there are as many cores; predicted
CASES: dict[str, tuple[float, dict[str, Any]]] = {  # megapixels, and the budget
    "small": (0.4, {"bpp": 0.25}),
    "large": (9.4, {"bpp": 0.25}),
    "default": (9.4, {"bytes": 50_000}),
}


class Stopwatch:
    """Time by stage, each without the stages within it, as one thread sees it."""

    def __init__(self) -> None:
        self._thread, self._stack, self._since = get_ident(), [REST], time.perf_counter()
        self.seconds = dict.fromkeys([*STAGES, REST], 0.0)

    def _turn(self) -> None:
        now = time.perf_counter()
        self.seconds[self._stack[-1]] += now - self._since
        self._since = now

    def timed(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, whose time counts as the stage's."""

        @wraps(function)
        def run(*arguments: Any, **options: Any) -> Any:
            if get_ident() != self._thread:
                return function(*arguments, **options)
            self._turn()
            self._stack.append(stage)
            try:
                return function(*arguments, **options)
            finally:
                self._turn()
                self._stack.pop()

        return run

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Time the stages within the block."""
        with ExitStack() as kept:
            for stage, name in ((stage, name) for stage, names in STAGES.items() for name in names):
                path, _, attribute = name.rpartition(".")
                before = vars(resolve_name(path))[attribute]
                timed = self.timed(stage, getattr(before, "__func__", before))
                kept.enter_context(patch(name, classmethod(timed) if isinstance(before, classmethod) else timed))
            yield
            self._turn()


def seconds(pixels: Pixels, options: dict[str, Any], threads: int) -> dict[str, float]:
    """The time of each stage of one encode, and of the whole."""
    set_threads(threads)
    watch = Stopwatch()
    with watch.watching():
        encode(pixels, **options)
    return {**watch.seconds, WHOLE: sum(watch.seconds.values())}


def stages_table(rows: list[dict[str, Any]]) -> str:
    """A line for each stage, those that scale least first."""
    threads = sorted({row["threads"] for row in rows})
    lines, predicted = {}, dict.fromkeys(MANY, 0.0)
    for stage in (WHOLE, *STAGES, REST):
        times = {n: statistics.median(row[stage] for row in rows if row["threads"] == n) for n in threads}
        first, last, more = times[threads[0]], times[threads[-1]], threads[-1] / threads[0]
        serial = min(max((more * last - first) / (more - 1), 0.0), first) if more > 1 else first
        cells = [stage, *(f"{seconds:.3f}" for seconds in times.values()), f"{first / max(last, 1e-9):.2f}"]
        lines[stage] = serial, [*cells, f"{serial:.3f}"]
        for n in MANY:
            predicted[n] += 0 if stage == WHOLE else serial + (first - serial) / n
    titles = " | ".join(["seconds", *(f"threads: {n}" for n in threads), "gain", "does not scale"])
    ordered = [cells for _, cells in sorted(lines.values(), key=lambda line: -line[0])]
    further = ", ".join(f"{predicted[n]:.2f} s with {n} threads" for n in MANY if n > threads[-1])
    return f"{table(titles, ordered)}\n\npredicted: {further}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, default=PHOTOGRAPHS)
    parser.add_argument("--cases", type=some_of(CASES, "case"), default=",".join(CASES))
    parser.add_argument("--threads", type=integers, default=[n for n in THREADS if n <= native.available_cores()])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--tune", default="psnr")
    parser.add_argument("--out", type=Path, default=RUNS / "threads.json")
    options = parser.parse_args()
    record = Record(options.out, "benchmarks.speed threads", {"tune": options.tune})
    paths = chosen_from(options.images, 64)
    encode(sized(paths, 0, 0.01), bpp=1)  # imports what an encode needs
    for case in options.cases:
        megapixels, budget = CASES[case]
        pixels = sized(paths, 0, megapixels)
        for repeat, threads in product(range(options.repeats), options.threads):
            key = {"case": case, "repeat": repeat, "threads": threads}
            if not record.has(**key):
                record.add({**key, **seconds(pixels, {"tune": options.tune, **budget}, threads)})
        print(f"\n{case}\n\n{stages_table([row for row in record.rows if row['case'] == case])}\n")
