"""Measure the parts of profile paper, as the tables of the paper's ablations do.

    python -m benchmarks.ablation --images FOLDER [--tables quantisation,positions,bitwidths] [--most 6]
                                  [--pictures kodim05] [--seeds 3] [--fit-steps 2000] [--tune-steps 1000]
    python -m benchmarks.ablation gains [--help]     the paper's start, before coding
    python -m benchmarks.ablation show JSON...       the tables of what either measured

Files of profile paper with 1,000, 3,000 and 7,000 Gaussians; of the table bitwidths, with 3,000. All of it takes hours
on two cores; a run can be extended by tables, pictures and seeds.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import torch

from benchmarks.ablation import gains, paper
from benchmarks.ablation.report import summary
from benchmarks.arguments import run_part, some_of
from benchmarks.machine import RUNS, Record, rows_of
from benchmarks.pictures import add_options, named_in


def measure(record: Record, tables: list[str], picture: Path, seed: int, steps: tuple[int, int]) -> None:
    """Measure rows of the tables, by number of Gaussians, as files of one number share their fit."""
    for asked in sorted({number for name in tables for number in paper.TABLES[name].numbers}):
        for name in tables:
            table = paper.TABLES[name]
            for setting in table.settings if asked in table.numbers else ():
                key = {"table": name, "setting": setting, "asked": asked, "image": picture.name, "seed": seed}
                if not record.has(**key):
                    record.add({**key, **paper.measure(table, setting, asked, picture, seed, steps)})


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.ablation", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_options(parser, most=6)
    parser.add_argument("--tables", type=some_of(paper.TABLES, "table"), default=",".join(paper.TABLES))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--fit-steps", type=int, default=2000, help="of the fit in floating point")
    parser.add_argument("--tune-steps", type=int, default=1000, help="of tuning it for a file")
    parser.add_argument("--out", type=Path, default=RUNS / "ablation.json")
    options = parser.parse_args()
    torch.set_num_threads(1)  # or its threads and the kernels' would wait for each other
    steps = options.fit_steps, options.tune_steps
    record = Record(options.out, "benchmarks.ablation", {"fit_steps": steps[0], "tune_steps": steps[1]})
    for picture in named_in(options):
        for seed in range(options.seeds):
            measure(record, options.tables, picture, seed, steps)
    print("", *summary(record.rows), sep="\n\n")


def show() -> None:
    """Print tables of JSON files: one of all that gains measured, and one of each other file."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ablation show", description=show.__doc__)
    parser.add_argument("json", type=Path, nargs="+")
    files = {path: rows_of(json.loads(path.read_text())) for path in parser.parse_args().json}
    fits = [row for rows in files.values() for row in rows if row["table"] not in paper.TABLES]
    if fits:
        print(gains.summary(fits))
    for path, rows in files.items():
        for text in summary(rows):
            print(f"\n{path.name}: {text}")


if __name__ == "__main__":
    sys.exit(run_part({"tables": main, "gains": gains.main, "show": show}, __doc__, default="tables"))
