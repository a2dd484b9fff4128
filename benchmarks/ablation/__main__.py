"""What parts and numbers are worth: of profile rd one part at a time, of profile paper every table of its ablations.

    python -m benchmarks.ablation --images FOLDER [--tables parts,quantisation,positions,ranges]
                                  [--most 6] [--pictures kodim05] [--seeds 3] [--bpp 0.25] [--steps N]
                                  [--fit-steps 2000] [--tune-steps 1000]
    python -m benchmarks.ablation gains [--help]             the paper's start and regularisation, before coding
    python -m benchmarks.ablation representation [--help]    N Gaussians before any is coded, in time and memory

parts: files of profile rd. quantisation, positions, ranges: files of profile paper, with 1,000, 3,000 and 7,000
Gaussians. All of it takes hours on two cores; a run can be extended by tables, pictures and seeds.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import torch

from benchmarks.ablation import gains, paper, parts, representation
from benchmarks.ablation.report import summary
from benchmarks.arguments import run_part, some_of
from benchmarks.machine import RUNS, Record
from benchmarks.pictures import add_options, named_in
from sgmethod.settings.rd import RD

TABLES = ("parts", *paper.TABLES)


def measure_parts(record: Record, picture: Path, seed: int, bpp: float, steps: int) -> None:
    """Measure the rows of the table of parts."""
    for part in parts.PARTS:
        key: dict[str, Any] = {"table": "parts", "without": part, "image": picture.name, "seed": seed}
        if not record.has(**key):
            record.add({**key, **parts.measure(part, picture, seed, bpp, steps)})


def measure_paper(record: Record, tables: list[str], picture: Path, seed: int, steps: tuple[int, int]) -> None:
    """Measure rows of the paper's tables, by number of Gaussians, as files of one number share their fit."""
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
    parser.add_argument(
        "--tables", type=some_of(TABLES, "table"), default=",".join(TABLES), help="those that are measured"
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--bpp", type=float, default=0.25, help="of the files of profile rd")
    parser.add_argument("--steps", type=int, default=RD.effort.steps, help="of profile rd")
    parser.add_argument("--fit-steps", type=int, default=2000, help="of a float fit of profile paper")
    parser.add_argument("--tune-steps", type=int, default=1000, help="of tuning it for a file")
    parser.add_argument("--out", type=Path, default=RUNS / "ablation.json")
    options = parser.parse_args()
    torch.set_num_threads(1)  # or its threads and the kernels' would wait for each other
    steps = {name: getattr(options, name) for name in ("steps", "fit_steps", "tune_steps")}
    record = Record(options.out, "benchmarks.ablation", {"bpp": options.bpp, **steps})
    for picture in named_in(options):
        for seed in range(options.seeds):
            if "parts" in options.tables:
                measure_parts(record, picture, seed, options.bpp, options.steps)
            of_paper = [name for name in paper.TABLES if name in options.tables]
            measure_paper(record, of_paper, picture, seed, (options.fit_steps, options.tune_steps))
    print("", *summary({"rows": record.rows}), sep="\n\n")


if __name__ == "__main__":
    commands = {"tables": main, "gains": gains.main, "gained": gains.show, "representation": representation.main}
    sys.exit(run_part(commands, __doc__, default="tables"))
