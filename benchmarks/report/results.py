"""The measured JSON, and how the documents write its numbers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from typing import Any

from benchmarks.machine import RESULTS, threads_of
from benchmarks.tables import number

Row = dict[str, Any]
LINKS = "../../benchmarks/results"  # from docs/results


@cache
def load(name: str) -> dict[str, Any]:
    """The JSON of that name, such as rd/kodak."""
    content: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text())
    return content


def rows(name: str) -> list[Row]:
    """The rows of a JSON."""
    return list(load(name)["rows"])


def sources(names: Sequence[str]) -> str:
    """One line: the JSON behind a page by the version that they measured, and when and on which machine that was."""
    files: dict[str, list[str]] = {}
    for name in names:
        threads = " (by one thread)" if threads_of(load(name)) == 1 else ""
        version = load(name).get("version", "1.0.0rc2")  # the first whose JSON do not say it
        files.setdefault(version, []).append(f"[{name}]({LINKS}/{name}.json){threads}")
    data = "; ".join(f"of {version}: {', '.join(links)}" for version, links in files.items())
    dates = sorted({load(name)["date"][:10] for name in names})
    machines = dict.fromkeys(f"{m['processor']}, {m['cores']} cores" for m in (load(name)["machine"] for name in names))
    commits = dict.fromkeys(load(name)["commit"] for name in names)
    return (
        f"<sub>Data {data}. Measured {' to '.join(dict.fromkeys((dates[0], dates[-1])))} on "
        f"{'; '.join(machines)}, commit {', '.join(commits)}. The JSON files also record the versions of all "
        "libraries.</sub>"
    )


def seconds(value: float) -> str:
    """Two digits, or more before the point."""
    return number(value, ".2g" if value < 10 else ".0f")
