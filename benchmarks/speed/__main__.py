"""Time and memory: by size of the picture, by number of Gaussians, of the kernels alone.

    python -m benchmarks.speed growth [--help]    seconds by megapixels for fixed bytes and the other way, beside AVIF
    python -m benchmarks.speed tensors [--help]   gradients of the differentiable renderer, beside plain torch
    python -m benchmarks.speed [--images FOLDER] [--only sizes,gaussians,kernels] [--megapixels 0.1,0.4,1.6,6,24]
                               [--gaussians 1000,3000,10000,30000,70000] [--bpp 0.25] [--repeats 3] [--out FILE]

sizes: encode, decode and peak of memory of profile rd, each in a process of its own, beside other codecs on the same
cores. gaussians: the same by number of Gaussians at 0.4 megapixels, and drawing and gradients of them alone. kernels:
every instruction set, one thread and all. Pictures larger than those of the folder are mosaics of them.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.arguments import integers, numbers, run_part, some_of
from benchmarks.machine import RUNS, Record
from benchmarks.pictures import chosen_from
from benchmarks.rd.rivals import versions
from benchmarks.speed import growth, kernels, sizes
from sgmethod import Budget
from sgmethod.native import native
from tests.harness.data import PHOTOGRAPHS

PARTS = ("sizes", "gaussians", "kernels")
MEGAPIXELS = 0.4  # where the number of Gaussians is asked for


def measure_gaussians(record: Record, path: Path, numbers: list[int], steps: int, rounds: int) -> None:
    """Drawing and gradients with every thread and the best instruction set."""
    pixels = kernels.load(path)
    best = range(native.best_isa(), native.best_isa() + 1)
    for n in numbers:
        if record.has(what="gaussians", gaussians=n):
            continue
        p, step_s = kernels.fitted(pixels, n, steps)
        row = {"what": "gaussians", "gaussians": n, "step_ms": round(1e3 * step_s, 3)}
        for found in kernels.measure(kernels.Jobs(p), rounds, best):
            if found["threads"] == native.thread_count():
                row[f"{found['job']}_ms"] = found["median_ms"]
        record.add(row)


def measure_kernels(record: Record, path: Path, steps: int, rounds: int) -> None:
    """Every instruction set and number of threads."""
    if record.has(what="kernel"):
        return
    p, _ = kernels.fitted(kernels.load(path), 5000, steps)
    for found in kernels.measure(kernels.Jobs(p), rounds, range(native.best_isa() + 1)):
        record.add({"what": "kernel", **found})


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, default=PHOTOGRAPHS)
    parser.add_argument("--only", type=some_of(PARTS, "part"), default=",".join(PARTS))
    parser.add_argument("--megapixels", type=numbers, default="0.1,0.4,1.6,6,24")
    parser.add_argument("--gaussians", type=integers, default="1000,3000,10000,30000,70000")
    parser.add_argument("--bpp", type=float, default=0.25)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--steps", type=int, default=300, help="of the fit before kernels are timed")
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--out", type=Path, default=RUNS / "speed.json")
    options = parser.parse_args()
    settings = {"bpp": options.bpp, "repeats": options.repeats, "steps": options.steps, "codecs": versions()}
    record = Record(options.out, "benchmarks.speed", settings)
    paths = chosen_from(options.images, 64)
    if "sizes" in options.only:
        for megapixels in options.megapixels:
            if not record.has(what="size", megapixels=megapixels):
                budget = Budget("bpp", options.bpp)
                record.add({"what": "size", **sizes.row(paths, megapixels, budget, options.repeats)})
    if "gaussians" in options.only:
        for n in options.gaussians:
            if not record.has(what="file", asked=n):
                found = sizes.row(paths, MEGAPIXELS, Budget("gaussians", n), options.repeats)
                record.add({"what": "file", "asked": n, **found})
        measure_gaussians(record, paths[0], options.gaussians, options.steps, options.rounds)
    if "kernels" in options.only:
        measure_kernels(record, paths[0], options.steps, options.rounds)


def measure_tensors() -> None:
    """Imported only here: torch would count towards the memory of the processes that encode."""
    from benchmarks.speed import tensors

    tensors.main()


if __name__ == "__main__":
    parts = {"sizes": main, "growth": growth.main, "tensors": measure_tensors}
    sys.exit(run_part(parts, __doc__, default="sizes"))
