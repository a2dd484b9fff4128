"""Compare the bytes of codecs at equal quality: the BD-rate of each picture, its mean and its standard error.

    python -m benchmarks.bd ANCHOR TEST [--figure psnr]

ANCHOR and TEST are tables with a line for each file of a picture: CSV with the columns codec, picture, bytes and psnr
(dB), and any others, such as source; or a JSON of this project's benchmarks. Every codec of TEST is compared with every
codec of ANCHOR over the pictures that both have, each at two rates or more. --figure: another column, of which more is
better, such as ssimulacra2.

BD-rate is Bjontegaard's difference in rate with piecewise cubic interpolation, as in the JCT-VC's spreadsheet. A
negative one means that TEST needs fewer bytes.
"""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Iterable
from itertools import product
from pathlib import Path
from typing import Any

from benchmarks.machine import rows_of
from benchmarks.rd.report import Point, bd_rate, shared
from benchmarks.tables import mean, number, standard_error, table

Curves = dict[str, dict[str, list[Point]]]  # by codec and picture


def curves(path: Path, figure: str) -> Curves:
    """Read a table. Exits with a message where it has no such columns."""
    with path.open(newline="") as file:
        rows: Iterable[dict[str, Any]] = rows_of(json.load(file)) if path.suffix == ".json" else [*csv.DictReader(file)]
    found: Curves = {}
    for line, row in enumerate(rows, start=2):
        try:
            picture, bytes_, quality = row.get("picture") or row["image"], float(row["bytes"]), row[figure]
            if quality not in (None, ""):
                found.setdefault(row["codec"], {}).setdefault(picture, []).append((bytes_, float(quality)))
        except KeyError as missing:
            raise SystemExit(f"{path} has no column {missing}; it needs codec, picture, bytes and {figure}") from None
        except ValueError:
            raise SystemExit(f"{path}, line {line}: bytes and {figure} must be numbers") from None
    return found


def compared(anchor: Curves, test: Curves) -> str:
    """A line for each codec of test against each of anchor."""
    lines = []
    for (theirs, old), (ours, new) in product(anchor.items(), test.items()):
        if theirs == ours:
            continue
        pairs = {picture: (old[picture], new[picture]) for picture in new if picture in old}
        rates = {picture: rate for picture, pair in pairs.items() if (rate := bd_rate(*pair)) is not None}
        ends = [shared(*pairs[picture]) for picture in rates]
        low, high = (mean([end[k] for end in ends]) for k in (0, 1))
        lines.append(
            [
                *(ours, theirs, f"{len(rates)} of {len(pairs)}"),
                *(number(mean([*rates.values()]), "+.2f"), number(standard_error([*rates.values()]), ".2f")),
                *(number(pick(rates.values()) if rates else None, "+.1f") for pick in (min, max)),
                f"{number(low, '.1f')} to {number(high, '.1f')}",
            ]
        )
    titles = "codec | against | pictures | BD-rate, % | standard error | least | most | over the qualities"
    return table(titles, lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("anchor", type=Path)
    parser.add_argument("test", type=Path)
    parser.add_argument("--figure", default="psnr")
    options = parser.parse_args()
    print(compared(*(curves(path, options.figure) for path in (options.anchor, options.test))))


if __name__ == "__main__":
    main()
