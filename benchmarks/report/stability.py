"""Pictures that are hard to code, extreme Gaussians, bad starts, and files that more time or bytes made worse."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from benchmarks.report.results import rows
from benchmarks.robustness import order
from benchmarks.robustness.stiff import Row, judged
from benchmarks.tables import MISSING, number, table

SETS = ("kernels", "fits", "strict")
VALUE, GRADIENT = "error of a pixel, over", "error of a gradient against"
# The rules of extreme numbers and bad starts, by how they begin in the JSON.
RULES = {
    VALUE: "Pixels drawn by the kernels agree with float64",
    GRADIENT: "Gradients agree with float64, for ratios of axes up to 1,000",
    "dB that the file is worse": "A fit from a bad start ends no worse than it began, nor than a single colour",
    "bytes above the budget": "A budget of very few or very many bytes is kept, or refused with a clear error",
    "encodes that np.errstate": "No encode fails when warnings and NumPy's underflow are errors",
    "dB between the best": "Encodes that chance alone tells apart have the same quality",
    "dB lost from the first": "Ten encodes in a row, each of the picture decoded before, keep the PSNR",
}


def extremes() -> list[dict[str, Any]]:
    """The rows of extreme numbers and bad starts."""
    return [row for name in ("stability", "strict") for row in rows(name) if row["set"] in SETS]


@cache
def ordered() -> list[order.Row]:
    """The rows of more time and more bytes."""
    return [order.Row(**row) for row in rows("order")]


@cache
def mirrored() -> list[order.Row]:
    """The rows of mirror images."""
    return [order.Row(**row) for row in rows("mirrors")]


@cache
def lines() -> list[list[Any]]:
    """For each rule: its words, its tolerance, the checks, those that fail, and the worst case."""
    found = list(judged([Row(**row) for row in rows("stiff")]))
    for start, says in RULES.items():
        own = [row for row in extremes() if row["rule"].startswith(start) and row["limit"] is not None]
        worst = max(own, key=lambda row: float("inf") if row["worst"] is None else row["worst"])
        unit = " dB" if start.startswith("dB") else ""
        broken = sum(row["verdict"] == "broken" for row in own)
        amount = "an error" if worst["worst"] is None else f"{number(worst['worst'], '.2g')}{unit}"
        where = f"{amount} ({worst['case']})" if worst["worst"] != 0 else MISSING
        found.append([says, f"{own[0]['limit']:g}{unit}", len(own), broken, where])
    return found + order.judged(ordered())


def rules_table() -> str:
    """A line for each rule."""
    return table("rule | tolerance | checks | failed | worst case", lines())


def worse_list() -> str:
    """A line for each file that more time or more bytes made worse."""
    return "\n".join(f"- {check}" for check in order.failures(ordered())) or "None."


def figures() -> dict[str, float]:
    """The figures of sentences, by mark."""
    checks, failed = (sum(line[k] for line in lines()) for k in (2, 3))
    found: dict[str, float] = {"stability.rules": len(lines()), "stability.kept": sum(not line[3] for line in lines())}
    found |= {"stability.checks": checks, "stability.failed": failed}
    for name, rule in (("longer", order.EFFORT), ("larger", order.SIZE)):
        found[f"stability.order-{name}"] = len({check.row.picture for check in order.checks(ordered(), rule)})
    return found | {f"stability.spread-{tune}": order.spread(mirrored(), tune) for tune in order.TOLERANCES}


def needles_table() -> str:
    """The worst error of kernels by the Gaussians' ratio of axes, a line for each kind and version."""
    lines: dict[str, list[str]] = {}
    ratios: dict[str, None] = {}
    for rule, kind in ((VALUE, "pixels"), (GRADIENT, "gradients")):
        for row in extremes():
            match = re.match(r"aspect ratio 1e(\d), (version \d)", row["case"])
            if match and row["rule"].startswith(rule):
                ratios[f"{10 ** int(match[1]):,}"] = None
                lines.setdefault(f"{kind}, {match[2]}", []).append(number(row["worst"], ".1e"))
    return table(" | ".join(["", *ratios]), [[name, *cells] for name, cells in lines.items()])
