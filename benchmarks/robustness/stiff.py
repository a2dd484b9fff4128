"""Profile rd on pictures that are hard for it: lines, letters, single pixels, noise, pictures of one row or one pixel.

    python -m benchmarks.robustness stiff [--pictures text,noise] [--only bpp,psnr] [--out PATH]

Each picture is encoded under budgets of two kinds, one encode at a time, and the rows of each picture are
checked against RULES.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.arguments import some_of
from benchmarks.machine import RUNS, Record
from benchmarks.pictures import Pixels
from benchmarks.robustness.drawings import PICTURES
from benchmarks.tables import MISSING, table
from sgmethod import Budget, BudgetError, Encoded, encode
from sgmethod.bitstream import container
from sgmethod.budget import BudgetKind
from sgmethod.native import native

BUDGETS: dict[BudgetKind, tuple[float, ...]] = {"bpp": (0.1, 0.3, 1, 2, 4, 8), "psnr": (25, 30, 35, 40)}
# What rounding to 8 bits leaves of a perfect picture: an error of 1/12 of a squared level. No better one is asked for.
EXACT_DB = 58.9


@dataclass(frozen=True)
class Row:
    """One encode; the fields of the JSON.

    value: the budget, in the unit of its kind; max_bytes: what a budget of kind bpp allows; bytes: of the file, None
    where there is none; psnr: dB of the decoded file, None for identical pixels and where there is no file; traced:
    bytes, PSNR and phase of the best point of the trace at the file's size; clipped: numbers that the encode clipped,
    and those of the file that are not finite; refused: why no file fits in a budget of kind bpp; error: any other
    reason for which there is no file.
    """

    picture: str
    kind: str
    value: float
    max_bytes: int | None = None
    bytes: int | None = None
    psnr: float | None = None
    gaussians: int | None = None
    seconds: float | None = None
    traced: tuple[int, float, str] | None = None
    clipped: int = 0
    refused: str | None = None
    error: str | None = None

    @property
    def size(self) -> int:
        """The file's bytes, where there is a file."""
        assert self.bytes is not None
        return self.bytes

    @property
    def db(self) -> float:
        """The file's PSNR, at most EXACT_DB: larger differences do not count."""
        return EXACT_DB if self.psnr is None else min(self.psnr, EXACT_DB)


def measure(picture: str, pixels: Pixels, budget: Budget) -> Row:
    """Encode a picture [H, W, 3] once. An encode that fails is a row too, and the next one follows."""
    height, width = pixels.shape[:2]
    max_bytes = budget.max_bytes(width, height)
    asked = Row(picture, budget.kind, budget.value, max_bytes)
    clipped_before = native.rd_clipped_values()
    try:
        encoded = encode(pixels, budget, tune="psnr")
    except Exception as error:
        why = f"{type(error).__name__}: {error}"
        too_small = isinstance(error, BudgetError) and max_bytes is not None
        return replace(asked, refused=why) if too_small else replace(asked, error=why)
    stats = encoded.stats
    known = [point for point in encoded.trace if 0 < point.bytes <= stats.bytes]
    best = max(known, key=lambda point: point.psnr, default=None)
    return replace(
        asked,
        bytes=stats.bytes,
        psnr=stats.psnr if math.isfinite(stats.psnr) else None,
        gaussians=stats.gaussians,
        seconds=round(stats.seconds, 2),
        traced=(best.bytes, best.psnr, best.phase) if best else None,
        clipped=native.rd_clipped_values() - clipped_before + not_finite(encoded),
    )


def not_finite(encoded: Encoded) -> int:
    """Count the numbers of the file's Gaussians that are not finite."""
    gaussians = container.parse(encoded.data).scene().gaussians
    return sum(int(np.count_nonzero(~np.isfinite(values))) for values in gaussians.arrays)


# A rule is a function of the rows of one picture. For each row that it applies to, it yields by how much the
# row breaks it, 0 at best. Its docstring is the rule in words.
Found = Iterator[tuple[Row, float]]


def fails(rows: Sequence[Row]) -> Found:
    """An encode ends with a file, or correctly reports that the budget is too small for one."""
    smallest = min((row.size for row in with_file(rows)), default=math.inf)
    for row in rows:
        yield row, float(row.error is not None or (row.refused is not None and smallest <= (row.max_bytes or 0)))


def falls(rows: Sequence[Row]) -> Found:
    """A file is no worse than one of fewer bytes."""
    group = with_file(rows, "bpp")
    for row in group:
        yield row, max((other.db - row.db for other in group if other.size < row.size), default=0.0)


def exceeds(rows: Sequence[Row]) -> Found:
    """A file does not exceed its budget."""
    for row in with_file(rows, "bpp"):
        yield row, float(row.size - (row.max_bytes or 0))


def misses(rows: Sequence[Row]) -> Found:
    """A target PSNR is reached if any file of the picture reaches it."""
    for row in with_file(rows, "psnr"):
        if any(other.db >= row.value for other in with_file(rows)):
            yield row, row.value - row.db


def clips(rows: Sequence[Row]) -> Found:
    """Every number in a file is finite, and none is clipped."""
    for row in with_file(rows):
        yield row, float(row.clipped)


def leaves_its_trace(rows: Sequence[Row]) -> Found:
    """A file is no worse than its trace showed at that size, or has the target PSNR."""
    for row in with_file(rows):
        if row.traced is not None:
            enough = row.db == EXACT_DB or (row.kind == "psnr" and row.db >= row.value)
            yield row, 0.0 if enough else row.traced[1] - row.db


def with_file(rows: Sequence[Row], kind: str = "") -> list[Row]:
    """The rows that have a file; of budgets of one kind, if it is given."""
    return [row for row in rows if row.bytes is not None and kind in ("", row.kind)]


# How much is tolerated, and its unit.
RULES: dict[Callable[[Sequence[Row]], Found], tuple[float, str]] = {
    fails: (0, "errors"),
    falls: (0.5, "dB"),
    exceeds: (0, "bytes"),
    misses: (0, "dB"),
    clips: (0, "numbers"),
    leaves_its_trace: (0.1, "dB"),
}


def judged(rows: Sequence[Row]) -> Iterator[list[Any]]:
    """For each rule: its words, its tolerance, the checks, those that fail, and the worst of them."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row.picture, []).append(row)
    for rule, (tolerance, unit) in RULES.items():
        checks = [check for group in groups.values() for check in rule(group)]
        broken = [check for check in checks if check[1] > tolerance]
        worst = MISSING
        if broken:
            row, by = max(broken, key=lambda check: check[1])
            worst = f"{by:.3g} {unit} ({row.picture}, {row.kind} {row.value:g})"
        yield [(rule.__doc__ or "").rstrip("."), f"{tolerance:g} {unit}", len(checks), len(broken), worst]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=some_of(PICTURES, "picture"), default=",".join(PICTURES))
    parser.add_argument("--only", type=some_of(BUDGETS, "kind of budget"), default=",".join(BUDGETS))
    parser.add_argument("--out", type=Path, default=RUNS / "stiff.json")
    options = parser.parse_args()
    record = Record(options.out, "benchmarks.robustness stiff", {})
    for picture in options.pictures:
        pixels = PICTURES[picture]()
        for budget in (Budget(kind, value) for kind in options.only for value in BUDGETS[kind]):
            if not record.has(picture=picture, kind=budget.kind, value=budget.value):
                record.add(asdict(measure(picture, pixels, budget)))
    lines = list(judged([Row(**row) for row in record.rows]))
    print(f"\n{table('rule | tolerance | checks | failed | worst case', lines)}")
