"""Profile rd on pictures that are hard for it: lines, letters, single pixels, noise, pictures of one row or one pixel.

    python -m benchmarks.robustness stiff [--pictures text,noise] [--seeds 3] [--only bpp,psnr] [--out PATH]

Each picture is encoded under budgets of two kinds, one encode at a time, and the rows of each picture and seed are
held against the rules of rules.py.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from benchmarks.arguments import some_of
from benchmarks.machine import RUNS, Record
from benchmarks.robustness.stiff.pictures import PICTURES
from benchmarks.robustness.stiff.rows import Row, measure
from benchmarks.robustness.stiff.rules import judged
from benchmarks.tables import table
from sgmethod import Budget
from sgmethod.budget import BudgetKind

BUDGETS: dict[BudgetKind, tuple[float, ...]] = {"bpp": (0.1, 0.3, 1, 2, 4, 8), "psnr": (25, 30, 35, 40)}


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.robustness stiff", description="Profile rd on hard pictures."
    )
    parser.add_argument("--pictures", type=some_of(PICTURES, "picture"), default=",".join(PICTURES))
    parser.add_argument("--seeds", type=int, default=3, help="encodes of each picture and budget")
    parser.add_argument("--only", type=some_of(BUDGETS, "kind of budget"), default=",".join(BUDGETS))
    parser.add_argument("--out", type=Path, default=RUNS / "stiff.json")
    options = parser.parse_args()
    record = Record(options.out, "benchmarks.robustness stiff", {})
    for picture in options.pictures:
        pixels = PICTURES[picture]()
        for seed in range(options.seeds):
            for budget in (Budget(kind, value) for kind in options.only for value in BUDGETS[kind]):
                if not record.has(picture=picture, seed=seed, kind=budget.kind, value=budget.value):
                    record.add(asdict(measure(picture, pixels, seed, budget)))
    lines = list(judged([Row(**row) for row in record.rows]))
    print(f"\n{table('rule | tolerance | checks | failed | worst case', lines)}")
