"""Tables of each setting's gain over the baseline, with the standard error over pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from benchmarks.rd.report import bd_psnr, bd_rate
from benchmarks.tables import mean, number, standard_error, table

Row = dict[str, Any]
Case = tuple[str, int]  # a picture and a seed
BySetting = dict[str, dict[Case, list[Row]]]

BASELINES = {"quantisation": "GSImage", "positions": "16", "bitwidths": "from 8 bits"}  # of each table
COLUMNS = {"psnr": ("PSNR", ".2f"), "bpp": ("bpp", ".3f"), "bits_of_factor": ("bits of l1, l2, l3, each", ".1f")}
Measure = Callable[[list[tuple[float, float]], list[tuple[float, float]]], float | None]  # of points by bpp and dB
MEASURES: dict[str, tuple[Measure, str]] = {"BD-PSNR, dB": (bd_psnr, ".2f"), "BD-rate, %": (bd_rate, ".1f")}


def worth(found: BySetting, setting: str, baseline: str, measure: Measure) -> tuple[float | None, float | None]:
    """The BD-PSNR or BD-rate of a setting against another: mean and standard error over pictures."""

    def points(setting: str, case: Case) -> list[tuple[float, float]]:
        return [(row["bpp"], row["psnr"]) for row in found[setting][case]]

    by_picture: dict[str, list[float | None]] = {}
    for case in found[setting]:
        by_picture.setdefault(case[0], []).append(measure(points(baseline, case), points(setting, case)))
    known = [value for values in by_picture.values() if (value := mean(values)) is not None]
    return mean(known), standard_error(known)


def average(cases: dict[Case, list[Row]], column: str) -> str:
    """The cell of one of COLUMNS: the mean over pictures, seeds and numbers of Gaussians."""
    return number(mean([row[column] for group in cases.values() for row in group]), COLUMNS[column][1])


def complete(rows: Sequence[Row]) -> BySetting:
    """Rows by setting, picture and seed, of the pictures that every setting and seed has."""
    found: BySetting = {}
    for row in rows:
        found.setdefault(row["setting"], {}).setdefault((row["image"], row["seed"]), []).append(row)
    seeds = {row["seed"] for row in rows}
    max_rows = max(len(group) for cases in found.values() for group in cases.values())
    whole = {
        image
        for image in {row["image"] for row in rows}
        if all(len(cases.get((image, seed), [])) == max_rows for cases in found.values() for seed in seeds)
    }
    return {s: {case: group for case, group in cases.items() if case[0] in whole} for s, cases in found.items()}


def summary(rows: Sequence[Row]) -> Iterator[str]:
    """A Markdown table for each of the paper's that was measured."""
    for name, baseline in BASELINES.items():
        found = complete(own) if (own := [row for row in rows if row["table"] == name]) else {}
        if not found.get(baseline):
            continue
        lines = []
        for setting, cases in found.items():
            cells = [average(cases, column) for column in COLUMNS]
            for measure, form in MEASURES.values():
                value, error = worth(found, setting, baseline, measure) if setting != baseline else (None, None)
                cells += [number(value, f"+{form}"), number(error, form)]
            lines.append([setting, *cells])
        titles = [name, *(title for title, _ in COLUMNS.values())]
        titles += [title for measured in MEASURES for title in (measured, "standard error")]
        count = len({image for image, _ in found[baseline]})
        yield f"{name}, against {baseline}, pictures: {count}\n\n{table(' | '.join(titles), lines)}"
