"""Error against run time, on one clock: files of each profile under time limits and at each effort, and other codecs.

    python -m benchmarks.convergence --images FOLDER [--most 5] [--pictures kodim05] [--megapixels 0.4]
                                     [--bpp 0.25] [--seconds 60] [--limits 0.25,0.5,1,2,4] [--paper-limits 1,3,10,30]
                                     [--methods rd,jpeg] [--few] [--cores 1]

The clock is wall time since the method got the pixels. rd and paper: one encode, and one under each time limit; rd
again with each effort. rd visual, rd fidelity and avif visual: tuned for the eye, where rd and avif are tuned for PSNR.
Other codecs: each speed or effort at the best quality within the budget. Seconds include the search for a file of that
size, ours and theirs; the search of another codec begins at the quality of its next quicker setting, which does not
count. encode_s is the encode that the search ends with, alone. mib: the peak of memory of an encode or search, over
what the process had before it.
rd until, rd fidelity until: into the bytes of AVIF at speed 4, the lowest effort that has its PSNR, or SSIMULACRA 2;
the table at the end compares their times.
--seconds: for paper, where no limit is shorter. --few: some settings of each other codec, three efforts of rd.
--cores: of this machine, for every codec; all.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.arguments import numbers, some_of
from benchmarks.machine import RUNS, Record, forget_peak, found, peak_bytes
from benchmarks.pictures import Pixels, add_options, named_in, pictures_in, sized
from benchmarks.rd.baselines import AvifOf10BitsForEyes, AvifOf10BitsForPsnr, Baseline, Jpeg, JpegXl, WebP, versions
from benchmarks.tables import MISSING, number, table
from sgmethod import Budget, decode, encode, set_threads
from sgmethod.metrics import psnr, ssimulacra2
from sgmethod.profiles import DEFAULT_EFFORT, EFFORTS, Profile, Tune

OURS: tuple[Profile, ...] = ("rd", "paper")
TUNED: dict[str, Tune] = {"rd visual": "visual", "rd fidelity": "fidelity"}
DECODES = 5
WARMED_ON = 64  # pixels along a side, by profile paper
OTHER_EFFORTS = tuple(effort for effort in EFFORTS if effort != DEFAULT_EFFORT)  # that one has nothing set
SOME_EFFORTS = (1, 3, 7)
# Every setting, and a few: the quickest first, since its quality is where the search of the next one begins.
BASELINES: dict[str, tuple[Callable[[int], Baseline], tuple[int, ...], tuple[int, ...]]] = {
    "jpeg": (lambda _: Jpeg(), (0,), (0,)),
    "webp": (WebP, tuple(range(7)), (0, 6)),
    "avif": (AvifOf10BitsForPsnr, tuple(range(9, -1, -1)), (9, 6, 4)),
    "avif visual": (AvifOf10BitsForEyes, tuple(range(9, -1, -1)), (9, 6, 4)),
    "jpegxl": (JpegXl, tuple(range(1, 10)), (3, 7)),
}
# A quality at a size: of ours, the tuning, and the codec and figure to reach at that codec's bytes.
GOALS: dict[str, tuple[Tune, str, str]] = {
    "rd until": ("psnr", "avif", "psnr"),
    "rd fidelity until": ("fidelity", "avif visual", "ssimulacra2"),
}
GOAL_SPEED = "4"
METHODS = (*OURS, *TUNED, *BASELINES, *GOALS)
Row = dict[str, Any]


def ours(
    pixels: Pixels,
    profile: Profile,
    budget: Budget,
    limit_s: float | None = None,
    effort: int = DEFAULT_EFFORT,
    tune: Tune = "psnr",
) -> Row:
    """Encode once."""
    encoded = encode(pixels, budget, profile, tune=tune, effort=effort, time_limit_s=limit_s)
    stats = encoded.stats
    row = {"bytes": stats.bytes, "gaussians": stats.gaussians, "seconds": stats.seconds, "mib": peak_bytes() / 2**20}
    return row | _decoded(partial(decode, encoded.data), pixels)


def until(pixels: Pixels, goal: Row, figure: str, tune: Tune) -> Row:
    """The encode of the lowest effort that has the figure of another codec's file within its bytes, or of the highest
    effort if none has."""
    for effort in EFFORTS:
        row = ours(pixels, "rd", Budget("bytes", goal["bytes"]), None, effort, tune) | {"effort": effort}
        if row[figure] >= goal[figure]:
            return row | {"reached": True}
    return row | {"reached": False}


def until_table(rows: Sequence[Row]) -> str:
    """A line for each size and goal: mean seconds over the pictures that reach it, ours and the other codec's."""
    lines = []
    every = [row for row in rows if row["method"] in GOALS]
    for megapixels, method in dict.fromkeys((row["megapixels"], row["method"]) for row in every):
        _, other, figure = GOALS[method]
        mine = [row for row in every if (row["megapixels"], row["method"]) == (megapixels, method)]
        seconds: list[tuple[float, float, float]] = []
        for row in mine:
            key = {"method": other, "setting": GOAL_SPEED, "picture": row["picture"], "megapixels": megapixels}
            if row["reached"] and (goal := found(key, rows)):
                seconds.append((row["seconds"], goal["encode_s"], goal["seconds"]))
        means = [number(statistics.fmean(column), ".2f") for column in zip(*seconds, strict=True)] or 3 * [MISSING]
        lines.append([f"{megapixels:g}", figure, f"{len(seconds)} of {len(mine)}", *means])
    return table("megapixels | figure | reached | ours, s | AVIF's encode, s | AVIF's search, s", lines)


def _decoded(run: Callable[[], Pixels], pixels: Pixels) -> Row:
    """The figures of a decode: the median time of several, after a first."""
    decoded, times = run(), []
    for _ in range(DECODES):
        began = time.perf_counter()
        run()
        times.append(1e3 * (time.perf_counter() - began))
    row = {"decode_ms": round(statistics.median(times), 3)}
    return row | {"psnr": psnr(decoded, pixels), "ssimulacra2": ssimulacra2(decoded, pixels)}


def point(baseline: Baseline, near: float | None, pixels: Pixels, bpp: float) -> Row:
    """Another codec's file within the budget, the seconds of its search and, of these, of the file's own encode.

    near: as Baseline.best takes it.
    """
    began = time.perf_counter()
    file = baseline.best(pixels, bpp, near)
    row: Row = {"bytes": len(file.data), "gaussians": None, "quality": file.quality}
    row |= {"seconds": time.perf_counter() - began, "encode_s": file.encode_s, "mib": peak_bytes() / 2**20}
    return row | _decoded(partial(baseline.decode, file.data), pixels)


class Run:
    """Measurements that go into one JSON."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        settings = {"bpp": options.bpp, "seconds": options.seconds, "codecs": versions()}
        self.record = Record(options.out, "benchmarks.convergence", settings)

    def all_of(self, picture: str, megapixels: float, pixels: Pixels) -> None:
        """Measure every method on one picture."""
        o, budget = self.options, Budget("bpp", self.options.bpp)
        # What the first of a process takes counts nowhere, and of rd what the first of a size takes.
        encode(pixels, bpp=o.bpp, tune="psnr")
        encode(pixels[:WARMED_ON, :WARMED_ON], gaussians=1, profile="paper")

        def once(method: str, setting: str, measure: Callable[[], Row]) -> None:
            key = {"method": method, "setting": setting, "picture": picture, "megapixels": megapixels}
            if method in o.methods and not self.record.has(**key):
                before = forget_peak()
                row = measure()
                self.record.add({**key, **row, "mib": row["mib"] - before / 2**20})

        for profile in OURS:
            limits = o.limits if profile == "rd" else o.paper_limits
            once(profile, "", partial(ours, pixels, profile, budget, None if profile == "rd" else o.seconds))
            for limit in limits:
                once(profile, f"{limit:g} s", partial(ours, pixels, profile, budget, limit))
        for method, tune in TUNED.items():
            once(method, "", partial(ours, pixels, "rd", budget, tune=tune))
        for effort in SOME_EFFORTS if o.few else OTHER_EFFORTS:
            once("rd", f"effort {effort}", partial(ours, pixels, "rd", budget, None, effort))
            for method, tune in TUNED.items():
                once(method, f"effort {effort}", partial(ours, pixels, "rd", budget, None, effort, tune))
        for method, (make, every, few) in BASELINES.items():
            for setting in few if o.few else every:
                near = self._quality(method, picture, megapixels)
                once(method, str(setting), partial(point, make(setting), near, pixels, o.bpp))
        for method, (tune, other, figure) in GOALS.items():
            key = {"method": other, "setting": GOAL_SPEED, "picture": picture, "megapixels": megapixels}
            if goal := found(key, self.record.rows):
                once(method, f"{other} {GOAL_SPEED}", partial(until, pixels, goal, figure, tune))

    def _quality(self, method: str, picture: str, megapixels: float) -> float | None:
        """The quality of another codec's last setting."""
        key = {"method": method, "picture": picture, "megapixels": megapixels}
        row = found(key, reversed(self.record.rows))
        return row["quality"] if row else None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_options(parser, most=5)
    parser.add_argument("--megapixels", type=numbers, default="0.4", help="such as 0.4,2,12")
    parser.add_argument("--bpp", type=float, default=0.25)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--limits", type=numbers, default="0.25,0.5,1,2,4", help="seconds, of rd")
    parser.add_argument("--paper-limits", type=numbers, default="1,3,10,30", help="seconds, of paper")
    parser.add_argument("--methods", type=some_of(METHODS, "method"), default=",".join(METHODS))
    parser.add_argument("--few", action="store_true")
    parser.add_argument("--cores", type=int, help="of this machine")
    parser.add_argument("--out", type=Path, default=RUNS / "convergence" / "0.4-megapixels.json")
    options = parser.parse_args()
    if options.cores:
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: options.cores])
        set_threads(options.cores)
    run = Run(options)
    every, wanted = pictures_in(options.images), named_in(options)
    for megapixels in options.megapixels:
        for path in wanted:
            run.all_of(path.stem, megapixels, sized(every, every.index(path), megapixels))
    print(f"\n{until_table(run.record.rows)}")


if __name__ == "__main__":
    main()
