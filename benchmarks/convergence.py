"""Error against run time, on one clock: files of each profile under time limits and at each effort, and other codecs.

    python -m benchmarks.convergence --images FOLDER [--most 5] [--pictures kodim05] [--megapixels 0.4]
                                     [--bpp 0.25] [--seconds 60] [--limits 0.25,0.5,1,2,4] [--paper-limits 1,3,10,30]
                                     [--methods rd,jpeg] [--few]

The clock is wall time since the method got the pixels. rd and paper: one encode, and one under each time limit; rd
again with each effort. rd visual and avif visual: tuned for the eye, where rd and avif are tuned for PSNR. Other
codecs: each speed or effort at the best quality within the budget. Seconds include the search for a file of that size,
ours and theirs; the search of another codec begins at the quality of its next quicker setting, which does not count.
--seconds: for paper, where no limit is shorter. --few: some settings of each other codec, three efforts of rd.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.arguments import numbers, some_of
from benchmarks.machine import RUNS, Record, found
from benchmarks.pictures import Pixels, add_options, named_in, pictures_in, sized
from benchmarks.rd.baselines import AvifOf10BitsForEyes, AvifOf10BitsForPsnr, Baseline, Jpeg, JpegXl, WebP, versions
from sgmethod import Budget, decode, encode
from sgmethod.metrics import psnr, ssimulacra2
from sgmethod.profiles import DEFAULT_EFFORT, EFFORTS, Profile, Tune

OURS: tuple[Profile, ...] = ("rd", "paper")
VISUAL = "rd visual"
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
METHODS = (*OURS, VISUAL, *BASELINES)
Row = dict[str, Any]


def ours(
    pixels: Pixels,
    profile: Profile,
    bpp: float,
    limit_s: float | None,
    effort: int = DEFAULT_EFFORT,
    tune: Tune = "psnr",
) -> Row:
    """Encode once."""
    encoded = encode(pixels, Budget("bpp", bpp), profile, tune=tune, effort=effort, time_limit_s=limit_s)
    stats = encoded.stats
    row = {"bytes": stats.bytes, "gaussians": stats.gaussians, "seconds": stats.seconds}
    return row | _decoded(partial(decode, encoded.data), pixels)


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
    row |= {"seconds": time.perf_counter() - began, "encode_s": file.encode_s}
    return row | _decoded(partial(baseline.decode, file.data), pixels)


class Run:
    """Measurements that go into one JSON."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        settings = {"bpp": options.bpp, "seconds": options.seconds, "codecs": versions()}
        self.record = Record(options.out, "benchmarks.convergence", settings)

    def all_of(self, picture: str, megapixels: float, pixels: Pixels) -> None:
        """Measure every method on one picture."""
        o = self.options
        # What the first of a process takes counts nowhere, and of rd what the first of a size takes.
        encode(pixels, bpp=o.bpp, tune="psnr")
        encode(pixels[:WARMED_ON, :WARMED_ON], gaussians=50, profile="paper", time_limit_s=0.1)

        def once(method: str, setting: str, measure: Callable[[], Row]) -> None:
            key = {"method": method, "setting": setting, "picture": picture, "megapixels": megapixels}
            if method in o.methods and not self.record.has(**key):
                self.record.add({**key, **measure()})

        for profile in OURS:
            limits = o.limits if profile == "rd" else o.paper_limits
            once(profile, "", partial(ours, pixels, profile, o.bpp, None if profile == "rd" else o.seconds))
            for limit in limits:
                once(profile, f"{limit:g} s", partial(ours, pixels, profile, o.bpp, limit))
        once(VISUAL, "", partial(ours, pixels, "rd", o.bpp, None, tune="visual"))
        for effort in SOME_EFFORTS if o.few else OTHER_EFFORTS:
            once("rd", f"effort {effort}", partial(ours, pixels, "rd", o.bpp, None, effort))
            once(VISUAL, f"effort {effort}", partial(ours, pixels, "rd", o.bpp, None, effort, "visual"))
        for method, (make, every, few) in BASELINES.items():
            for setting in few if o.few else every:
                near = self._quality(method, picture, megapixels)
                once(method, str(setting), partial(point, make(setting), near, pixels, o.bpp))

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
    parser.add_argument("--out", type=Path, default=RUNS / "convergence" / "0.4-megapixels.json")
    options = parser.parse_args()
    run = Run(options)
    every, wanted = pictures_in(options.images), named_in(options)
    for megapixels in options.megapixels:
        for path in wanted:
            run.all_of(path.stem, megapixels, sized(every, every.index(path), megapixels))


if __name__ == "__main__":
    main()
