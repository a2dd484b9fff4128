"""Profile rd on photographs: neither a longer schedule nor more bytes may make a file worse.

    python -m benchmarks.robustness order --images FOLDER [--most 40] [--pictures hill_fog] [--megapixels 0.1]
                                          [--bpp 0.05,0.1,0.25,0.5,1,1.5] [--efforts 5] [--tunes psnr] [--mirrors 1]

Each picture is reduced to --megapixels and encoded for each tuning, rate and effort. A file tuned for PSNR is judged by
that, others by SSIMULACRA 2 without their texture. Up to four mirror images of each show what chance alone changes.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path

from benchmarks.arguments import integers, numbers, some_of
from benchmarks.machine import RUNS, Record
from benchmarks.pictures import MIRRORS, Pixels, add_options, mirrored, named_in
from benchmarks.speed.growth import reduced
from benchmarks.tables import MISSING, table
from sgmethod import View, decode, encode
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import psnr, ssimulacra2
from sgmethod.profiles import DEFAULT_EFFORT, TUNES, Tune

EFFORT, SIZE = "A longer schedule ends no worse than any shorter one", "A file is no worse than any smaller one"
# Decibels for a file tuned for PSNR, points of SSIMULACRA 2 for others. Chance alone makes files worse by less: mirror
# images differ with a standard deviation of 0.03 dB and 0.8 points, and a file is held against the best of several.
TOLERANCES = {"psnr": 0.1, "fidelity": 1.5, "visual": 1.5}
UNITS = {"psnr": "dB", "fidelity": "points", "visual": "points"}


@dataclass(frozen=True)
class Row:
    """One encode; the fields of the JSON. figure: dB or points, more is better."""

    picture: str
    tune: Tune
    bpp: float
    effort: int
    mirror: int  # 0: the picture as it is
    bytes: int
    figure: float


@dataclass(frozen=True)
class Check:
    """A row, and by how much it is worse than the best of those with less time or fewer bytes."""

    row: Row
    worse_by: float

    @property
    def failed(self) -> bool:
        """Whether it is worse by more than is tolerated."""
        return self.worse_by > TOLERANCES[self.row.tune]

    def __str__(self) -> str:
        row, by = self.row, f"{self.worse_by:.2g} {UNITS[self.row.tune]}"
        return f"{row.picture}, tuned for {row.tune}, {row.bpp:g} bpp, effort {row.effort}: {by}"


def measure(picture: str, pixels: Pixels, tune: Tune, bpp: float, effort: int, mirror: int) -> Row:
    """Encode a picture [H, W, 3] once."""
    pixels = mirrored(pixels, mirror)
    data = encode(pixels, bpp=bpp, tune=tune, effort=effort).data
    figure = (psnr if tune == "psnr" else ssimulacra2)(decode(data, view=View(texture=False)), pixels)
    assert figure is not None
    return Row(picture, tune, bpp, effort, mirror, len(data), round(figure, 4))


def checks(rows: Sequence[Row], rule: str) -> Iterator[Check]:
    """Each row that has others with less time, or with fewer bytes: no mirror image, and for bytes one effort."""
    first = [row for row in rows if row.mirror == 0 and (rule == EFFORT or row.effort == DEFAULT_EFFORT)]
    for row in first:
        if rule == EFFORT:
            less = [one for one in first if _same(one, row) and one.bpp == row.bpp and one.effort < row.effort]
        else:
            less = [one for one in first if _same(one, row) and one.bytes < row.bytes]
        if less:
            yield Check(row, max(0.0, max(one.figure for one in less) - row.figure))


def failures(rows: Sequence[Row]) -> list[Check]:
    """The checks of both rules that fail."""
    return [check for rule in (EFFORT, SIZE) for check in checks(rows, rule) if check.failed]


def _same(one: Row, other: Row) -> bool:
    return (one.picture, one.tune) == (other.picture, other.tune)


def spread(rows: Sequence[Row], tune: str) -> float:
    """The standard deviation over mirror images of a tuning, over all pictures; 0 where no picture has several."""
    groups: dict[tuple[object, ...], list[float]] = {}
    for row in rows:
        if row.tune == tune:
            groups.setdefault((row.picture, row.bpp, row.effort), []).append(row.figure)
    found = [statistics.variance(group) for group in groups.values() if len(group) > 1]
    return statistics.fmean(found) ** 0.5 if found else 0.0


def judged(rows: Sequence[Row]) -> list[list[object]]:
    """For each rule and tuning: its words, its tolerance, the checks, those that fail, and the worst of them."""
    lines: list[list[object]] = []
    for rule, tune in product((EFFORT, SIZE), TUNES):
        if found := [check for check in checks(rows, rule) if check.row.tune == tune]:
            failed = sorted((check for check in found if check.failed), key=lambda check: -check.worse_by)
            unit = f"{TOLERANCES[tune]:g} {UNITS[tune]}"
            worst = str(failed[0]) if failed else MISSING
            lines.append([f"{rule}, tuned for {tune}", unit, len(found), len(failed), worst])
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_options(parser, most=40)
    parser.add_argument("--megapixels", type=float, default=0.1)
    parser.add_argument("--bpp", type=numbers, default="0.05,0.1,0.25,0.5,1,1.5")
    parser.add_argument("--efforts", type=integers, default=[DEFAULT_EFFORT])
    parser.add_argument("--tunes", type=some_of(TUNES, "tuning"), default="psnr")
    parser.add_argument("--mirrors", type=int, default=1, choices=range(1, MIRRORS + 1))
    parser.add_argument("--out", type=Path, default=RUNS / "order.json")
    options = parser.parse_args()
    record = Record(options.out, "benchmarks.robustness order", {"megapixels": options.megapixels})
    for path in named_in(options):
        pixels = reduced(read_image_8_bit(path.read_bytes()), options.megapixels)
        for key in product(options.tunes, options.bpp, options.efforts, range(options.mirrors)):
            named = dict(zip(("tune", "bpp", "effort", "mirror"), key, strict=True))
            if not record.has(picture=path.stem, **named):
                record.add(asdict(measure(path.stem, pixels, *key)))
    rows = [Row(**row) for row in record.rows]
    print(f"\n{table('rule | tolerance | checks | failed | worst case', judged(rows))}")
    print(*failures(rows), sep="\n")
