"""Profile rd on pictures that are hard for it: lines, letters, single pixels, noise, pictures of one row or one pixel.

    python -m benchmarks.robustness stiff [--pictures text,noise] [--seeds 3] [--only bpp,psnr,quality] [--out PATH]
    python -m benchmarks.robustness stiff --judge [--out PATH]
    python -m benchmarks.robustness stiff --draw FOLDER

Each picture is encoded under budgets of three kinds, one encode at a time, and the rows of each picture and seed are
held against the rules of rules.py. The JSON has every row and violation. What it already holds for the same code and
machine is not done again, so an interrupted run goes on where it stopped. --judge encodes nothing and judges the rows
of the JSON again. --draw writes the pictures as PNG.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.machine import RUNS, command, in_words, kept_rows, origin, write_json
from benchmarks.robustness.stiff.pictures import PICTURES
from benchmarks.robustness.stiff.report import counted, report, violation
from benchmarks.robustness.stiff.rows import Key, Row, measure
from benchmarks.robustness.stiff.rules import judge
from sgmethod import Budget
from sgmethod.budget import BudgetKind
from sgmethod.io.files import write_atomically
from sgmethod.io.png import encode_png

BUDGETS: dict[BudgetKind, tuple[float, ...]] = {
    "bpp": (0.1, 0.3, 1, 2, 4, 8),
    "psnr": (25, 30, 35, 40),
    "quality": tuple(range(10, 101, 10)),
}


def draw(names: Sequence[str], folder: Path) -> None:
    """Write pictures to a folder as PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        write_atomically(folder / f"{name}.png", encode_png(PICTURES[name]()))


def run(names: Sequence[str], seeds: int, kinds: Sequence[BudgetKind], path: Path) -> None:
    """Encode what the JSON at the path does not hold yet, and add it there row by row."""
    where = {"command": command("benchmarks.robustness stiff"), **origin(), "remark": "", "settings": {}}
    rows: dict[Key, Row] = {}
    for kept in kept_rows(path, where):
        rows[Row(**kept).key] = Row(**kept)
    for name in names:
        pixels = PICTURES[name]()
        for seed in range(seeds):
            for budget in (Budget(kind, value) for kind in kinds for value in BUDGETS[kind]):
                if (name, seed, budget.kind, budget.value) in rows:
                    continue
                row = measure(name, pixels, seed, budget)
                rows[row.key] = row
                write_json(path, {**where, "rows": [asdict(r) for r in rows.values()]})
                print(row, flush=True)


def summarise(path: Path) -> str:
    """Judge the rows of the JSON, add the verdicts to it and return a summary."""
    content = json.loads(path.read_text())
    rows = [Row(**row) for row in content.pop("rows")]
    checks = judge(rows)
    content["rules"] = counted(checks)
    content["violations"] = [violation(check) for check in checks if check.broken]
    write_json(path, {**content, "rows": [asdict(row) for row in rows]})
    return f"{report(rows, checks)}\n\n{in_words(content)}"


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.robustness stiff", description="Profile rd on hard pictures."
    )
    parser.add_argument("--pictures", default=",".join(PICTURES), help="names, each a picture of its own; all")
    parser.add_argument("--seeds", type=int, default=3, help="encodes of each picture and budget")
    parser.add_argument("--only", default=",".join(BUDGETS), help="kinds of budget")
    parser.add_argument("--out", type=Path, default=RUNS / "stiff.json")
    parser.add_argument("--judge", action="store_true", help="judge the rows of the JSON anew, encode nothing")
    parser.add_argument("--draw", type=Path, metavar="FOLDER", help="write the pictures there, encode nothing")
    options = parser.parse_args()
    names, kinds = options.pictures.split(","), options.only.split(",")
    unknown = {*names} - {*PICTURES} | {*kinds} - {*BUDGETS}
    if unknown:
        parser.error(f"{', '.join(sorted(unknown))}: no such name; there are {', '.join([*PICTURES, *BUDGETS])}")
    if options.draw:
        draw(names, options.draw)
        return
    if not options.judge:
        run(names, options.seeds, kinds, options.out)
    if not options.out.exists():
        parser.error(f"there are no rows in {options.out}")
    print(summarise(options.out))
