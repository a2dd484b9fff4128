"""What each setting of an ablation is worth against its anchor, with the standard error over pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from benchmarks.rd.report import bd_psnr
from benchmarks.tables import in_all, mean, number, standard_error, table

Row = dict[str, Any]
Case = tuple[str, int]  # a picture and a seed
By = dict[str, dict[Case, list[Row]]]  # by setting of a table
Figure = Callable[[list[Row]], float | None]  # of the rows of one picture and seed
Worth = tuple[float | None, float | None]  # dB, and their standard error over pictures

ANCHORS = {"parts": "nothing", "quantisation": "GSImage", "positions": "16", "ranges": "minimum and maximum"}
CODED = ("quantisation", "positions", "ranges")  # by BD-PSNR of files with several numbers of Gaussians
TITLES = {
    "parts": "Profile `rd` without one part",
    "quantisation": "Profile `paper`: quantisation of the covariance, by BD-PSNR",
    "positions": "Profile `paper`: bits of a position, by BD-PSNR",
    "ranges": "Profile `paper`: where the ranges of factors start, by BD-PSNR",
}
COLUMNS = {
    **{"psnr": ("PSNR", ".2f"), "bpp": ("bpp", ".4f")},
    **{"gaussians": ("Gaussians", ",.0f"), "seconds": ("seconds", ".1f")},
}
# Of fits with a fixed number of Gaussians.
REPRESENTATIONS = ("rd", "paper")
FIGURES = {"psnr": ".2f", "ms_ssim": ".4f", "lpips": ".4f", "seconds": ".1f", "frames_per_s": ",.4g", "mib": ".0f"}


def representations(rows: Sequence[Row], asked: int) -> dict[str, Row]:
    """Means by method, for one number of Gaussians, over the pictures that every method has; with their number."""
    found: dict[str, Row] = {}
    mine = in_all([row for row in rows if row["asked"] == asked and row["method"] in REPRESENTATIONS], "method")
    for method in REPRESENTATIONS:
        own = [row for row in mine if row["method"] == method]
        if own:
            found[method] = {"pictures": len(own), **{name: mean([row.get(name) for row in own]) for name in FIGURES}}
    return found


def rows_of(content: Row, name: str) -> list[Row]:
    """The rows of one table. A part's setting is what is left out."""
    return [{"setting": row.get("without"), **row} for row in content["rows"] if row.get("table") == name]


def worth(content: Row, name: str, setting: str, other: str) -> Worth:
    """How much better a setting is than another of a table: BD-PSNR of files, or PSNR with the most Gaussians. None
    where it was not measured."""
    rows = rows_of(content, name)
    if not {setting, other} <= {row["setting"] for row in rows}:
        return None, None
    by, cases = complete(rows)

    def more(both: list[Row]) -> float | None:
        if name in CODED:
            return bd_psnr(*([(r["bpp"], r["psnr"]) for r in both if r["setting"] == of] for of in (other, setting)))
        most = max(row.get("asked", 0) for row in both)
        pair = {row["setting"]: row["psnr"] for row in both if row.get("asked", 0) == most}
        return float(pair[setting] - pair[other])

    return over_pictures({case: [*by[other][case], *by[setting][case]] for case in cases}, more)


def complete(rows: Sequence[Row]) -> tuple[By, list[Case]]:
    """Rows by setting, picture and seed, for the pictures that every setting and seed has; and these cases."""
    by: By = {}
    for row in rows:
        by.setdefault(row["setting"], {}).setdefault((row["image"], row["seed"]), []).append(row)
    seeds = sorted({row["seed"] for row in rows})
    most = max(len(found) for cases in by.values() for found in cases.values())
    whole = [
        image
        for image in dict.fromkeys(row["image"] for row in rows)
        if all(len(cases.get((image, seed), [])) == most for cases in by.values() for seed in seeds)
    ]
    kept = [(image, seed) for image in whole for seed in seeds]
    return {setting: {case: cases[case] for case in kept} for setting, cases in by.items()}, kept


def over_pictures(cases: dict[Case, list[Row]], figure: Figure) -> Worth:
    """The mean over pictures of the mean over seeds, and the standard error over pictures."""
    by_picture: dict[str, list[float | None]] = {}
    for (picture, _), rows in cases.items():
        by_picture.setdefault(picture, []).append(figure(rows))
    known = [value for values in by_picture.values() if (value := mean(values)) is not None]
    return mean(known), standard_error(known)


def summary(content: Row) -> Iterator[str]:
    """A table for each ablation that was measured: every setting against the first."""
    for name, anchor in ANCHORS.items():
        rows = rows_of(content, name)
        if name not in CODED:  # as worth() compares them
            most = max((row.get("asked", 0) for row in rows), default=0)
            rows = [row for row in rows if row.get("asked", 0) == most]
        by, cases = complete(rows) if rows else ({}, [])
        if not cases:
            continue
        lines = []
        for setting, own in by.items():
            db, error = worth(content, name, setting, anchor)
            within = db is not None and setting != anchor and abs(db) < (error or 0)
            figures = (
                number(over_pictures(own, lambda rows, name=column: mean([r.get(name) for r in rows]))[0], form)  # type: ignore[misc]
                for column, (_, form) in COLUMNS.items()
            )
            gain = "" if setting == anchor else number(db, "+.2f") + " (within the error)" * within
            lines.append([setting, gain, "" if setting == anchor else number(error, ".3f"), *figures])
        pictures, seeds = (len({case[k] for case in cases}) for k in (0, 1))
        titles = [
            "setting",
            f"dB against {'the whole' if anchor == 'nothing' else anchor}",
            "standard error",
            *(title for title, _ in COLUMNS.values()),
        ]
        counted = f"{pictures} picture{'s' * (pictures > 1)}, {seeds} seed{'s' * (seeds > 1)}"
        yield f"{TITLES[name]} ({counted}):\n\n{table(' | '.join(titles), lines)}"
