"""Extreme Gaussians, and fits from bad starts: what was tried, the rule, the worst figure seen, the verdict.

    python -m benchmarks.robustness extremes [--sets kernels,fits,strict] [--cases "aspect ratio"] [--out FILE]

kernels: extreme Gaussians against the definition in float64. fits: bad starts, rates, budgets, mirror images and
generations. strict: hard pictures where warnings and NumPy's underflow are errors.
Damaged files are `make sanitize` and `make fuzz`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from benchmarks.arguments import some_of
from benchmarks.machine import RUNS, Record
from benchmarks.robustness import fits, kernels
from benchmarks.robustness.case import Cases

SETS: dict[str, Callable[[argparse.Namespace], Cases]] = {
    "kernels": lambda _: kernels.cases(),
    "fits": lambda options: fits.cases(options.side, options.generations),
    "strict": lambda _: fits.strict_cases(),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=some_of(SETS, "set"), default=",".join(SETS))
    parser.add_argument("--cases", default="", help="those whose name begins so; all")
    parser.add_argument("--side", type=int, default=64, help="pixels along the picture that is fitted")
    parser.add_argument("--generations", type=int, default=10)
    parser.add_argument("--out", type=Path, default=RUNS / "stability.json")
    options = parser.parse_args()
    record = Record(options.out, "benchmarks.robustness extremes", {"side": options.side})
    for name in options.sets:
        for case in SETS[name](options):
            if case.name.startswith(options.cases) and not record.has(set=name, case=case.name, rule=case.rule):
                record.add({"set": name, **case.row()})
