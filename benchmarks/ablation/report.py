"""What each part is worth, and the paper's tables of that kind beside ours."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

from benchmarks.rd.report import bd_quality, bd_rate
from benchmarks.report.fits import order, quoted, quoted_values
from benchmarks.report.section import Content, Section, mean, number, table

Row = dict[str, Any]
Case = tuple[str, int]  # a picture and a seed
By = dict[str, dict[Case, list[Row]]]  # by row of a table
Figure = Callable[[list[Row]], float | None]  # of what was measured of one picture with one seed

NAMES = {
    "regularisation": "Weight of the regularisation",
    "ratio": "Ratio of the start",
    "quantisation": "Quantisation of the covariance",
    "positions": "Bits of a position",
}
# The paper's table, and the figure by which its rows have an order
QUOTED = {
    "regularisation": ("regularisation weight, Kodak, 70,000 Gaussians", "psnr"),
    "quantisation": ("quantisation of covariance, Kodak, against GSImage", "bd_psnr_db"),
    "positions": ("bits of a position, against 16", "bd_psnr_db"),
}
ANCHORS = {"quantisation": "GSImage", "positions": "16"}
EXPLAINED = {
    "regularisation": "The paper does not say how its Sobel kernels are scaled: ours are divided by 8, and the last "
    "row has them as they are.",
    "ratio": "The ratio is of the Gaussians that regions of much, some and little structure get. Dynamic: with more "
    "Gaussians it goes over to an even one, which it is from the paper's N_t on.",
    "quantisation": "A factor is a number of a Gaussian's shape. LSQ: all factors have so many bits, and a learned "
    "step; ABQ: each Gaussian has bits of its own, and each bit a price, the weight.",
}


def section(content: Content) -> Section:
    """From ablation.json. Rows without a table are parts of profile rd, means over all pictures with one seed."""
    rows = [{"table": "parts", "image": None, "seed": 0, **row} for row in content["rows"]]
    tables, said = [], []
    for name in (name for name in ("parts", *NAMES) if any(row["table"] == name for row in rows)):
        mine = [{"setting": row.get("without"), **row} for row in rows if row["table"] == name]
        if name == "parts":
            by, cases = _complete(mine)
            tables.append(_heading(f"Profile `rd`, part by part, at {content['settings']['bpp']:g} bpp", cases, mine))
            tables.append(_parts(by))
            said.append(_worst(by, content["settings"]["bpp"]))
        elif name in ANCHORS:
            tables += _coded(name, mine)
        else:
            tables += _float(name, mine)
        if name in QUOTED:
            tables += quoted(QUOTED[name][0])
    missing = [title for name, (title, _) in QUOTED.items() if name not in {row["table"] for row in rows}]
    tables += [part for title in missing for part in quoted(title)]
    said.append("Differences do not add up, and a part that is worth little on these pictures may decide on others.")
    if any("image" in row for row in content["rows"]):
        said.append(
            "A spread is the standard deviation, over seeds, of the mean over pictures; what is less than the larger "
            "spread of two rows is marked, and says nothing."
        )
    return Section("ablation", "Part by part", " ".join(said), tables, [content])


def worth(content: Content, name: str, setting: str, other: str) -> tuple[float | None, float | None]:
    """What a setting has more than another in a table, in dB, and the spread of that over seeds: of files BD-PSNR, of
    float fits PSNR. None where it was not measured."""
    rows = [row for row in content["rows"] if row.get("table") == name]
    if not {setting, other} <= {row["setting"] for row in rows}:
        return None, None
    by, cases = _complete(rows)
    paired = {case: [*by[other][case], *by[setting][case]] for case in cases}

    def more(both: list[Row]) -> float | None:
        if name in ANCHORS:
            return bd_quality(*(_points(both, of) for of in (other, setting)))
        most = max(row["asked"] for row in both)
        pair = {row["setting"]: row["psnr"] for row in both if row["asked"] == most}
        return float(pair[setting] - pair[other])

    return _mean(paired, more)


def _complete(rows: Sequence[Row]) -> tuple[By, list[Case]]:
    """By row of the table what each picture with each seed has, for the pictures that are complete."""
    by: By = {}
    for row in rows:
        by.setdefault(row["setting"], {}).setdefault((row["image"], row["seed"]), []).append(row)
    seeds = sorted({row["seed"] for row in rows})
    numbers = max(len(found) for cases in by.values() for found in cases.values())
    whole = [
        image
        for image in dict.fromkeys(row["image"] for row in rows)
        if all(len(cases.get((image, seed), [])) == numbers for cases in by.values() for seed in seeds)
    ]
    kept = [(image, seed) for image in whole for seed in seeds]
    return {setting: {case: cases[case] for case in kept} for setting, cases in by.items()}, kept


def _mean(cases: dict[Case, list[Row]], figure: Figure) -> tuple[float | None, float | None]:
    """The mean over seeds of the mean over pictures, and the spread of it."""
    by_seed: dict[int, list[float | None]] = {}
    for (_, seed), rows in cases.items():
        by_seed.setdefault(seed, []).append(figure(rows))
    means = [mean(values) for values in by_seed.values()]
    known = [value for value in means if value is not None]
    return mean(means), statistics.stdev(known) if len(known) > 1 else None


def _of(name: str, asked: int | None = None) -> Figure:
    """The mean of a figure over the rows with so many Gaussians; over all if it is not said."""

    def figure(rows: list[Row]) -> float | None:
        return mean([row.get(name) for row in rows if asked is None or row["asked"] == asked])

    return figure


def _heading(title: str, cases: Sequence[Case], rows: Sequence[Row]) -> str:
    pictures, seeds = ({case[k] for case in cases} for k in (0, 1))
    if None in pictures or not pictures:
        return f"### {title}"
    sizes = f"{len(pictures)} picture{'s' * (len(pictures) > 1)}, {len(seeds)} seed{'s' * (len(seeds) > 1)}"
    dropped = len({row["image"] for row in rows} - pictures)
    alone = ", of which no spread is known" if len(seeds) == 1 else ""
    return f"### {title}\n\n{sizes}{alone}{f'; {dropped} more not yet complete' if dropped else ''}."


def _steps(previous: tuple[float | None, float | None], own: tuple[float | None, float | None]) -> str:
    """What a row has more than the one above, marked if the seeds alone could make it."""
    if previous[0] is None or own[0] is None:
        return "-"
    spread = max(previous[1] or 0.0, own[1] or 0.0)
    difference = own[0] - previous[0]
    return f"{difference:+.2f}{' (within the spread)' if abs(difference) < spread else ''}"


def _against_above(found: Sequence[tuple[float | None, float | None]]) -> list[str]:
    return ["", *(_steps(above, own) for above, own in pairwise(found))]


def _parts(by: By) -> str:
    whole, spread = _mean(by["nothing"], _of("psnr"))
    lines = []
    for setting, cases in by.items():
        own = _mean(cases, _of("psnr"))
        change = "+0.00" if setting == "nothing" else _steps((whole, spread), own)
        others = (number(_mean(cases, _of(name))[0], form) for name, form in _OTHERS.items())
        lines.append([setting, number(own[0], ".2f"), number(own[1], ".3f"), change, *others])
    return table("without | PSNR | spread | change | bpp | Gaussians | seconds", lines)


_OTHERS = {"bpp": ".4f", "gaussians": ".0f", "seconds": ".1f"}


def _worst(by: By, bpp: float) -> str:
    means = {setting: _mean(cases, _of("psnr"))[0] for setting, cases in by.items()}
    losses = {setting: (means["nothing"] or 0) - value for setting, value in means.items() if value is not None}
    worst = max(losses, key=lambda setting: losses[setting])
    return (
        f"What is each part of profile `rd` worth, by the PSNR without it at {bpp:g} bpp? "
        f"{worst[0].upper()}{worst[1:]} is worth most, {losses[worst]:.2f} dB."
    )


def _float(name: str, rows: Sequence[Row]) -> list[str]:
    """A table of float fits for each number of Gaussians."""
    by, cases = _complete(rows)
    found = [_heading(f"{NAMES[name]}, profile `paper`, before any quantising", cases, rows)]
    if not cases:
        return found
    found[0] += " Pictures at half the size, with as many Gaussians a pixel as 768x512 pixels have with those named."
    found[0] += f" {EXPLAINED[name]}" if name in EXPLAINED else ""
    for asked in sorted({row["asked"] for row in rows}):
        means = {setting: _mean(own, _of("psnr", asked)) for setting, own in by.items()}
        above = _against_above(list(means.values()))
        lines = [
            [
                setting,
                number(own[0], ".2f"),
                number(own[1], ".3f"),
                step,
                number(_mean(by[setting], _of("ms_ssim", asked))[0], ".5f"),
                number(_mean(by[setting], _of("seconds", asked))[0], ".1f"),
            ]
            for (setting, own), step in zip(means.items(), above, strict=True)
        ]
        titles = "| PSNR | spread | against the row above | MS-SSIM | seconds"
        counts = {row["gaussians"] for rows in by[next(iter(by))].values() for row in rows if row["asked"] == asked}
        fitted = f", here {', '.join(f'{n:,}' for n in sorted(counts))}" if counts != {asked} else ""
        heading = f"{asked:,} Gaussians{fitted}:\n\n"
        found.append(heading + table(f"{NAMES[name].lower()} {titles}", lines))
        if name in QUOTED:
            found.append(_order(name, means))
    if name == "ratio":
        found.append(_ratio(by, max(row["asked"] for row in rows)))
    return found


def _ratio(by: By, asked: int) -> str:
    """The paper shows this as a plot and says what came out."""
    fixed, dynamic = (_mean(by[setting], _of("psnr", asked)) for setting in ("fixed, 6:2:1", "dynamic"))
    every = sorted({row["asked"] for rows in by["dynamic"].values() for row in rows})
    beside = [
        f"{_steps(*(_mean(by[setting], _of('psnr', n)) for setting in ('even, 1:1:1', 'dynamic')))} with {n:,}"
        for n in every
    ]
    return (
        "The paper has a plot of this, without figures: beyond 50,000 Gaussians a fixed ratio loses, the dynamic one "
        f"does not. Here, with {asked:,}, the dynamic one against the fixed one, in dB: {_steps(fixed, dynamic)}. "
        f"Against the even one: {', '.join(beside)}."
    )


def _coded(name: str, rows: Sequence[Row]) -> list[str]:
    """A table of BD figures against the first row, from files with several numbers of Gaussians."""
    by, cases = _complete(rows)
    anchor = ANCHORS[name]
    found = [_heading(f"{NAMES[name]}, profile `paper`, by files", cases, rows)]
    if not cases:
        return found
    asked = ", ".join(f"{n:,}" for n in sorted({row["asked"] for row in rows}))
    what = "profile `baseline`" if anchor == "GSImage" else f"{anchor} bits"
    found[0] += f" BD-PSNR and BD-rate against {what}, of each picture's files with {asked} Gaussians."
    if name == "quantisation":
        found[0] += f" {EXPLAINED[name]} Where a weight sets the bitwidths, they start at a mean of 7.5 bits."

    def gaps(setting: str, gap: Callable[..., float | None]) -> tuple[float | None, float | None]:
        paired = {case: [*by[anchor][case], *own] for case, own in by[setting].items()}
        return _mean(paired, lambda both: gap(*(_points(both, of) for of in (anchor, setting))))

    others = [setting for setting in by if setting != anchor]
    means = {setting: gaps(setting, bd_quality) for setting in others}
    lines = []
    for setting, step in zip(others, _against_above(list(means.values())), strict=True):
        rate, spread = gaps(setting, bd_rate)
        figures = (number(_mean(by[setting], _of(figure))[0], form) for figure, form in _CODED.items())
        db = (number(means[setting][0], "+.2f"), number(means[setting][1], ".3f"))
        lines.append([setting, *db, step, number(rate, "+.1f"), number(spread, ".2f"), *figures])
    titles = "| BD-PSNR, dB | spread | against the row above | BD-rate, % | spread | PSNR | bpp | bits of a factor"
    return [*found, table(f"{NAMES[name].lower()} {titles}", lines), _order(name, means)]


_CODED = {"psnr": ".2f", "bpp": ".4f", "bits_of_factor": ".2f"}


def _points(rows: Sequence[Row], setting: str) -> list[tuple[float, float]]:
    return [(row["bpp"], row["psnr"]) for row in rows if row["setting"] == setting]


def _order(name: str, means: dict[str, tuple[float | None, float | None]]) -> str:
    known = {setting: value for setting, (value, _) in means.items() if value is not None}
    spreads = {setting: spread or 0.0 for setting, (_, spread) in means.items()}
    theirs = quoted_values(*QUOTED[name])
    told = f"Beside the paper's table: {order(known, theirs, spreads)}"
    turned = [
        f"{setting} ({known[setting]:+.2f} dB here, {theirs[setting]:+.2f} there)"
        for setting in known
        if name in ANCHORS and setting in theirs and known[setting] * theirs[setting] < 0
    ]
    return told + (
        f" Better here and worse there, or the other way round, beside {ANCHORS[name]}: {', '.join(turned)}."
        if turned
        else ""
    )
