"""Pictures that are hard to code, extreme Gaussians and bad starts."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from benchmarks.report.plots import style
from benchmarks.report.section import MISSING, Content, Draw, Page, number, several, table
from benchmarks.robustness.stiff.rows import Row
from benchmarks.robustness.stiff.rules import judged

SETS = ("kernels", "fits", "strict")
SHORT = {
    "error of a pixel, over": "A pixel drawn by a kernel, against float64",
    "error of a gradient against": "A gradient, against float64, up to a ratio of axes of 1,000",
    "dB that the file is worse": "A fit from a bad start ends no worse than it began, nor than a single colour",
    "bytes above the budget": "A budget of very few or very many bytes is kept, or refused with an error",
    "encodes that np.errstate": "No encode is ended where warnings and NumPy's underflow are errors",
    "dB between the best": "Ten seeds of one encode give the same quality",
    "dB lost from the first": "Ten generations, each encoded from the one before, keep their PSNR",
}
VALUE, GRADIENT = (next(key for key in SHORT if word in key) for word in ("pixel", "gradient"))


def page(contents: Mapping[str, Content]) -> Page:
    """The page from stiff.json, stability.json and strict.json, as far as there are."""
    stiff, extremes = contents.get("stiff"), [contents[name] for name in ("stability", "strict") if name in contents]
    rows = [row for content in extremes for row in content["rows"] if row["set"] in SETS]
    hard = [Row(**row) for row in stiff["rows"]] if stiff else []
    lines = [*(judged(hard) if hard else ()), *extreme_lines(rows)]
    panels: list[Draw] = [partial(draw, rows=rows, rule=rule) for rule in (VALUE, GRADIENT)] if rows else []
    failing = [line for line in lines if line[3]]
    checks, broken = (sum(line[k] for line in lines) for k in (2, 3))
    held = f"{len(lines) - len(failing)} of {len(lines)} rules hold in every check"
    cases = dict.fromkeys(str(line[4]).partition("(")[2].rstrip(")").partition(",")[0] for line in failing)
    return Page(
        name="stability",
        title="Stability",
        question="Does anything break when pictures are hard to code, numbers are extreme or starting points are bad? "
        "Hard pictures are lines one pixel wide, text, checkerboards, noise, single rows and single pixels.",
        table=table("rule | tolerance | checks | failed | worst case", lines),
        conclusion=f"{held}; {broken} of {checks:,} checks fail. "
        + (f"The worst cases are {several([*cases])}." if failing else "No check fails."),
        limits="- Cases that nobody thought of, and pictures between these and photographs.\n"
        "- Gradients of Gaussians more than 1,000 times as long as wide, which have no tolerance.\n"
        "- Whether a picture looks right: the rules are about bytes, decibels and finite numbers.\n"
        "- Damaged files: `make sanitize` and `make fuzz` decode those.",
        command="python -m benchmarks --full --only robustness",
        contents=contents,
        panels=panels,
        of="the worst error of kernels by the Gaussians' ratio of axes, and the limit",
    )


def extreme_lines(rows: Sequence[dict[str, Any]]) -> list[list[Any]]:
    """Each rule of kernels and fits, and its worst case."""
    lines = []
    for start, says in SHORT.items():
        own = [row for row in rows if row["rule"].startswith(start) and row["limit"] is not None]
        if own:
            worst = max(own, key=lambda row: float("inf") if row["worst"] is None else row["worst"])
            unit = " dB" if start.startswith("dB") else ""
            broken = sum(row["verdict"] == "broken" for row in own)
            where = f"{number(worst['worst'], '.2g')}{unit} ({worst['case']})" if worst["worst"] != 0 else MISSING
            lines.append([says, f"{own[0]['limit']:g}{unit}", len(own), broken, where])
    return lines


def draw(axes: Any, rows: Sequence[dict[str, Any]], rule: str) -> None:
    """The error of kernels by the ratio of axes, and its limit."""
    mine = [row for row in rows if row["rule"].startswith(rule) and row["worst"]]
    for k, version in enumerate(("version 1", "version 2")):
        found = [(re.match(rf"aspect ratio (\S+), {version}", row["case"]), row["worst"]) for row in mine]
        points = [(float(match[1]), worst) for match, worst in found if match]
        axes.plot(*zip(*points, strict=True), **style(k) | {"label": f"files of {version}"})
    limit = next(row["limit"] for row in mine if row["limit"] is not None)
    axes.axhline(limit, **style(3) | {"marker": "", "label": "limit"})
    axes.set(xscale="log", yscale="log", xlabel="ratio of axes", ylabel="pixels" if rule == VALUE else "gradients")
