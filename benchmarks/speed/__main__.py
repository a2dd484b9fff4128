"""Time and memory: by size of the picture, and of the kernels alone.

    python -m benchmarks.speed growth [--help]    seconds by megapixels for fixed bytes and the other way, beside AVIF
    python -m benchmarks.speed threads [--help]   which stages of an encode do not scale with the threads
    python -m benchmarks.speed [--images FOLDER] [--only sizes,kernels] [--megapixels 0.1,0.4,1.6,6,24]
                               [--bpp 0.25] [--repeats 3] [--out FILE]

sizes: encode, decode and peak of memory of profile rd, each in a process of its own, beside other codecs on the same
cores. kernels: every instruction set, one thread and all. Pictures larger than those of the folder are mosaics of them.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.arguments import numbers, run_part, some_of
from benchmarks.machine import RUNS, Record
from benchmarks.pictures import chosen_from
from benchmarks.rd.baselines import versions
from benchmarks.speed import growth, kernels, sizes, threads
from tests.support.data import PHOTOGRAPHS

PARTS = ("sizes", "kernels")
GAUSSIANS = 5000  # on which the kernels are timed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, default=PHOTOGRAPHS)
    parser.add_argument("--only", type=some_of(PARTS, "part"), default=",".join(PARTS))
    parser.add_argument("--megapixels", type=numbers, default="0.1,0.4,1.6,6,24")
    parser.add_argument("--bpp", type=float, default=0.25)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--steps", type=int, default=300, help="steps of the fit before kernels are timed")
    parser.add_argument("--rounds", type=int, default=40, help="times that each kernel is timed")
    parser.add_argument("--out", type=Path, default=RUNS / "speed.json")
    options = parser.parse_args()
    settings = {"bpp": options.bpp, "repeats": options.repeats, "steps": options.steps, "codecs": versions()}
    record = Record(options.out, "benchmarks.speed", settings)
    paths = chosen_from(options.images, 64)
    for megapixels in options.megapixels if "sizes" in options.only else ():
        if not record.has(what="size", megapixels=megapixels):
            record.add({"what": "size", **sizes.row(paths, megapixels, options.bpp, options.repeats)})
    if "kernels" in options.only and not record.has(what="kernel"):
        gaussians = kernels.fitted(kernels.load(paths[0]), GAUSSIANS, options.steps)
        for row in kernels.measure(gaussians, options.rounds):
            record.add({"what": "kernel", **row})


if __name__ == "__main__":
    sys.exit(run_part({"sizes": main, "growth": growth.main, "threads": threads.main}, __doc__, default="sizes"))
