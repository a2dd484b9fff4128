"""The measured JSON, and how the documents write its numbers."""

from __future__ import annotations

import json
import statistics
from collections.abc import Sequence
from functools import cache
from typing import Any

from benchmarks.machine import RESULTS, rows_of, threads_of
from benchmarks.tables import number, standard_error

Row = dict[str, Any]
LINKS = "../../benchmarks/results"  # from docs/results
# Commits whose encoder makes the files of this version, but for a processor's last bits and rounds that come apart
# (notebook, optimiser.md).
SAME_FILES = (
    "86c86bb1d67f",
    "e5deed7f08e6",
    "5f690937f91c",
    "b1fce0073842",
    "453c9ee34699",
    "08be4e916414",
)
# What does not depend on the encoder: other codecs, kernels, and the service, which is loaded with a few files.
WITHOUT_FILES = ("gpu", "rd/avif", "rd/others", "service/")


@cache
def load(name: str) -> dict[str, Any]:
    """The JSON of that name, such as rd/kodak."""
    content: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text())
    return content


def rows(name: str) -> list[Row]:
    """The rows of a JSON."""
    return rows_of(load(name))


def sources(names: Sequence[str]) -> str:
    """One line: the JSON behind a page, each with its commit, and when and on which machine they were measured."""
    files = [f"[{name}]({LINKS}/{name}.json) ({_origin(name)})" for name in names]
    dates = sorted({load(name)["date"][:10] for name in names})
    used = [(load(name)["machine"]["processor"], load(name)["machine"]["cores"]) for name in names]
    machines = dict.fromkeys(f"{processor}, {cores} core{'s' * (cores != 1)}" for processor, cores in used)
    return (
        f"<sub>Data and commits: {', '.join(files)}. Measured {' to '.join(dict.fromkeys((dates[0], dates[-1])))} on "
        f"{'; '.join(machines)}. The JSON files also record the versions of all "
        "libraries.</sub>"
    )


def _origin(name: str) -> str:
    """The threads and the commit of a JSON, and whether today's encoder makes its files."""
    found = load(name)
    words = ["by one thread"] * (threads_of(found) == 1) + [found["commit"]]
    again = [row for row in rows("again") if (row["result"], row["commit"]) == (name, found["commit"])]
    if again and all(row["alike"] for row in again):
        words.append(f"{len(again)} files made again are alike")
    elif again:
        more = [row["psnr"] - row["published"]["psnr"] for row in again]
        error = standard_error(more) or 0.0
        words.append(f"{len(again)} files made again have {statistics.fmean(more):+.3f} ± {error:.3f} dB")
    elif found["commit"] not in SAME_FILES and not name.startswith(WITHOUT_FILES):
        words.append("earlier encoder")
    return ", ".join(words)


def seconds(value: float) -> str:
    """Two digits, or more before the point."""
    return number(value, ".2g" if value < 10 else ".0f")
