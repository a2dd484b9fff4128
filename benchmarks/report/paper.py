"""The paper's tables, and its figure: PSNR by the number of Gaussians, before coding."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from benchmarks.ablation import gains
from benchmarks.ablation.paper import BITWIDTHS, RANGES, SHORT, STAGES, WEAK
from benchmarks.ablation.report import COLUMNS, BySetting, average, complete, worth
from benchmarks.rd.report import Point, bd_psnr, bd_rate
from benchmarks.report.plots import style
from benchmarks.report.results import Row, rows
from benchmarks.tables import mean, number, standard_error, table

STARTS = {"random": "random", "fixed": "structure-guided, 6:2:1", "dynamic": "structure-guided, dynamic ratio"}
GSIMAGE, ABQ, PRINTED = "GSImage", "ABQ, weight 0.0012", ", gradient as printed"
BASELINES = (GSIMAGE, RANGES, STAGES, SHORT, WEAK)
# What the paper reports of each row of its files, by BD-PSNR and BD-rate.
CLAIMED = {
    "GSImage, structure-guided start": "-18 %",
    "LSQ, 6 bits": "+0.78 dB, -26.3 %",
    "LSQ, 7 bits": "+1.16 dB, -35.2 %",
    "LSQ, 8 bits": "+1.18 dB, -35.3 %",
    **{f"{ABQ}{printed}": "+1.68 dB, -43.4 %" for printed in ("", PRINTED)},
    **{f"ABQ, weight 0.0014{printed}": "+0.96 dB, -30.3 %" for printed in ("", PRINTED)},
    "14": "+0.19 dB, -6.4 %",
    "12": "+0.34 dB, -11.0 %",
    "10": "-0.34 dB, +8.2 %",
}
APART_DB = 5  # a fit came apart if it ends that far below the median of its seeds
JPEGS = {"jpeg": "libjpeg-turbo", "mozjpeg": "mozjpeg"}
BEYOND = 1.2  # times the highest rate measured: as far as a curve of JPEG is extended
NAMES = {ABQ: f"{ABQ} (profile `paper`)", "ABQ, 7.5 bits by a budget": "ABQ, 7.5 bits by a budget (ours)"}


def files(name: str) -> BySetting:
    """The rows of one of the paper's tables by setting, picture and seed."""
    return complete(rows(name))


def gain(found: BySetting, setting: str, baseline: str) -> list[str]:
    """The cells of BD-PSNR and BD-rate, each with its standard error; empty against itself."""
    if setting == baseline:
        return ["", ""]
    (db, db_error), (percent, error) = (worth(found, setting, baseline, measure) for measure in (bd_psnr, bd_rate))
    return [
        f"{number(db, '+.2f')} ± {number(db_error, '.2f')} dB",
        f"{number(percent, '+.1f')} ± {number(error, '.1f')} %",
    ]


def files_table() -> str:
    """Files of each setting, against GSImage."""
    found = files("ablation")
    lines = [
        [
            NAMES.get(setting, setting),
            *(average(cases, column) for column in COLUMNS),
            *gain(found, setting, GSIMAGE),
            CLAIMED.get(setting, "-") if setting != GSIMAGE else "",
        ]
        for setting, cases in found.items()
        if setting == GSIMAGE or setting not in BASELINES
    ]
    return table("files | PSNR | bpp | bits of l1, l2, l3, each | BD-PSNR | BD-rate | the paper", lines)


def baselines_table() -> str:
    """GSImage made weaker, and what ABQ gains over each."""
    found = files("ablation")
    lines = [
        [
            "as above" if setting == GSIMAGE else setting.removeprefix(f"{GSIMAGE}, "),
            average(found[setting], "psnr"),
            gain(found, setting, GSIMAGE)[0],
            *gain(found, "GSImage, structure-guided start", setting),
            *gain(found, ABQ, setting),
        ]
        for setting in BASELINES
    ]
    return table(
        "GSImage | PSNR | BD-PSNR | BD-PSNR of the start | BD-rate of the start | BD-PSNR of ABQ | BD-rate of ABQ",
        lines,
    )


def positions_table() -> str:
    """Bits of a coordinate, against 16."""
    found = files("positions")
    lines = [[bits, *gain(found, bits, "16"), CLAIMED[bits]] for bits in found if bits != "16"]
    return table("bits | BD-PSNR | BD-rate | the paper", lines)


def bitwidths_table() -> str:
    """Where bitwidths end, by where they begin and which gradient moves them, and how they follow the sizes."""
    found, lines = files("bitwidths"), []
    for start in BITWIDTHS:
        cells = [start]
        for setting in (start, f"{start}{PRINTED}"):
            cells += [average(found[setting], "bits_of_factor"), number(mean(follow(found, setting)), "+.2f")]
        lines.append(cells)
    columns = "bits at the end | their rank correlation with the size"
    return table(f"bitwidths begin | {columns} | as printed: bits at the end | their rank correlation", lines)


def follow(found: BySetting, setting: str) -> list[float]:
    """By picture, the rank correlation of the bitwidth and the size of a Gaussian."""
    return [row["bits_by_size"] for group in found[setting].values() for row in group]


def jpeg_table() -> str:
    """Files with 12 bits of a coordinate beside JPEG, interpolated to their rates."""
    lines = []
    for codec, name in JPEGS.items():
        for asked in sorted({row["asked"] for row in rows("positions")}):
            if pairs := beside_jpeg(asked, codec):
                columns = zip(zip(*pairs, strict=True), (".3f", ".2f", ".2f"), strict=True)
                cells = [number(mean(each), form) for each, form in columns]
                apart = [ours - theirs for _, ours, theirs in pairs]
                db = f"{number(mean(apart), '+.2f')} ± {number(standard_error(apart), '.2f')} dB"
                better = f"{sum(one > 0 for one in apart)} of {len(apart)}"
                lines.append([name, f"{asked:,}", *cells, db, better])
    return table("JPEG by | Gaussians | bpp | PSNR | JPEG's PSNR | difference | ours is better on", lines)


def beside_jpeg(asked: int, codec: str) -> list[tuple[float, float, float]]:
    """By picture: rate and PSNR of a file with 12 bits of a coordinate, and JPEG's PSNR at that rate. Empty if JPEG was
    not measured at such a rate on every picture.
    """
    curves: dict[str, set[Point]] = {}
    for row in rows("rd/others"):
        if row["codec"] == codec:
            curves.setdefault(row["image"], set()).add((row["bpp"], row["psnr"]))
    ours = [row for row in rows("positions") if (row["setting"], row["asked"]) == ("12", asked)]
    theirs = [at_rate(sorted(curves[row["image"]]), row["bpp"]) for row in ours]
    pairs = zip(ours, theirs, strict=True)
    found = [(row["bpp"], row["psnr"], db) for row, db in pairs if db is not None]
    return found if len(found) == len(ours) else []


def at_rate(points: Sequence[Point], bpp: float) -> float | None:
    """PSNR at a rate, linear in the log rate between neighbours; beyond the last point for BEYOND its rate at most."""
    if not points[0][0] <= bpp <= BEYOND * points[-1][0]:
        return None
    (low, low_db), (high, high_db) = next((pair for pair in pairwise(points) if bpp <= pair[1][0]), points[-2:])
    return low_db + (high_db - low_db) * math.log(bpp / low) / math.log(high / low)


def bound() -> tuple[float | None, float | None]:
    """BD-PSNR over GSImage, mean and standard error, of files with the best PSNR of any choice of bits, if all of them
    were as small as those with 6 bits.
    """
    found = files("ablation")
    choices = [setting for setting in found if setting.startswith(("LSQ", "ABQ"))]
    found["bound"] = {
        case: [
            {"bpp": row["bpp"], "psnr": max(found[setting][case][k]["psnr"] for setting in choices)}
            for k, row in enumerate(smallest)
        ]
        for case, smallest in found["LSQ, 6 bits"].items()
    }
    return worth(found, "bound", GSIMAGE, bd_psnr)


Fits = dict[str, list[Row]]  # by picture, a row for each seed


def fits(name: str) -> dict[tuple[int, str], Fits]:
    """The fits of a JSON by number of Gaussians and setting."""
    found: dict[tuple[int, str], Fits] = {}
    for row in rows(name):
        found.setdefault((row["asked"], row["setting"]), {}).setdefault(row["image"], []).append(row)
    return found


def optimiser_table() -> str:
    """Fits of crops by GaussianImage's optimiser and by ours, and what start and regularisation gain."""
    theirs, ours, lines = fits("gains/optimiser"), fits("gains/crops"), []
    for (asked, setting), found in theirs.items():
        plain = setting.partition(" +")[0]
        cells = [f"{asked:,}", STARTS[plain].removeprefix("structure-guided, ") + setting.removeprefix(plain)]
        for of in (theirs, ours):
            if mine := of.get((asked, setting)):
                cells += [psnr(mine), above(mine, of[asked, "random"])]
            else:
                cells += ["", ""]
        lines.append([*cells, above(found, theirs[asked, plain])])
    titles = "Gaussians | start | PSNR | dB against random | PSNR by our optimiser | dB against random"
    return table(f"{titles} | dB by regularisation", lines)


def seeds_table() -> str:
    """Fits of the same crops from several seeds by GaussianImage's optimiser."""
    found, lines = fits("gains/seeds"), []
    starts = {start: found[70_000, start] for start in ("random", "dynamic")}
    for image in starts["random"]:
        for start, by_image in starts.items():
            every = [row["psnr"] for row in by_image[image]]
            cells = [f"{number(db, '.2f')}{' (came apart)' if apart else ''}" for db, apart in marked(every)]
            lines.append([image, STARTS[start].removeprefix("structure-guided, "), *cells])
        gained = [f"{gain:+.2f}" for gain, _ in seed_gains(image)]
        lines.append(["", "gain, dB", *gained])
    columns = [f"seed {row['seed']}" for row in next(iter(starts["random"].values()))]
    return table(" | ".join(["crop", "start", *columns]), lines)


def marked(every: Sequence[float]) -> list[tuple[float, bool]]:
    """The PSNR of fits that differ by the seed alone, and whether they came apart."""
    return [(db, db < statistics.median(every) - APART_DB) for db in every]


def seed_gains(image: str) -> list[tuple[float, bool]]:
    """The start's gain by seed, and whether one of the two fits came apart."""
    found = fits("gains/seeds")
    random, dynamic = (marked([row["psnr"] for row in found[70_000, start][image]]) for start in ("random", "dynamic"))
    return [(mine[0] - other[0], mine[1] or other[1]) for mine, other in zip(dynamic, random, strict=True)]


def psnr(found: Fits) -> str:
    """The mean over pictures."""
    return number(mean([gains.figure(one, "psnr") for one in found.values()]), ".2f")


def above(found: Fits, others: Fits) -> str:
    """The cell of a gain over other fits, with its standard error over pictures; empty over itself."""
    return "" if found is others else " ± ".join(gains.gain(found, others, "")[1:3])


def gains_by_number() -> dict[str, dict[int, list[float]]]:
    """By start and number of Gaussians: the PSNR of each picture, above that of a random start."""
    by_fit = {(row["setting"], row["asked"], row["image"]): row["psnr"] for row in rows("gains/numbers")}
    found: dict[str, dict[int, list[float]]] = {start: {} for start in STARTS}
    for (start, asked, image), psnr in sorted(by_fit.items()):
        if ("random", asked, image) in by_fit:
            found[start].setdefault(asked, []).append(psnr - by_fit["random", asked, image])
    for asked in found["dynamic"].keys() - found["fixed"].keys():
        found["fixed"][asked] = found["dynamic"][asked]  # the dynamic ratio begins as the fixed one
    return found


def figures() -> dict[str, float | None]:
    """The figures of the page, by mark."""
    found = files("ablation")
    marks: dict[str, float | None] = {"paper.pictures": len({image for image, _ in found[GSIMAGE]})}
    marks["paper.bound"], marks["paper.bound-error"] = bound()
    percent, error = worth(found, ABQ, GSIMAGE, bd_rate)
    marks["paper.fewer-bits"], marks["paper.fewer-bits-error"] = -percent if percent else None, error
    short = worth(found, ABQ, SHORT, bd_rate)[0]
    marks["paper.fewer-bits-short"] = -short if short else None
    return marks | seed_figures()


def seed_figures() -> dict[str, float | None]:
    """The figures of fits from several seeds, by mark."""
    starts = [
        [one["psnr"] for one in every] for by_image in fits("gains/seeds").values() for every in by_image.values()
    ]
    found = [pair for image in dict.fromkeys(row["image"] for row in rows("gains/seeds")) for pair in seed_gains(image)]
    every, whole = [gain for gain, _ in found], [gain for gain, apart in found if not apart]
    return {
        "paper.seeds-db": mean([statistics.stdev(each) for each in starts]),
        "paper.seeds-fits": sum(map(len, starts)),
        "paper.seeds-apart": sum(apart for each in starts for _, apart in marked(each)),
        "paper.seeds-gain": mean(every),
        "paper.seeds-gain-error": standard_error(every),
        "paper.seeds-median": statistics.median(every),
        "paper.seeds-gain-whole": mean(whole),
        "paper.seeds-gain-whole-error": standard_error(whole),
    }


def draw(axes: Any) -> None:
    """Gain over a random start against the number of Gaussians, with standard errors."""
    for k, (start, by_number) in enumerate(gains_by_number().items()):
        numbers = sorted(by_number)
        means, errors = ([figure(by_number[n]) for n in numbers] for figure in (mean, standard_error))
        axes.errorbar(numbers, means, errors, **style(k) | {"label": STARTS[start]})
    axes.set(xlabel="Gaussians, of a picture of 768x512 pixels", ylabel="dB above a random start")
