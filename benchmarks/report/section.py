"""What a page of results is made of: a question, a plot, a table, a conclusion, its limits and a command."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.machine import threads_of
from benchmarks.tables import MISSING, mean, number, table

__all__ = ["MISSING", "Content", "Draw", "Page", "load", "mean", "number", "percent", "seconds", "several", "table"]

Content = dict[str, Any]  # of a JSON
Draw = Callable[[Any], None]  # on the axes of matplotlib
JOIN = "\n\n".join
MOST_ROWS = 13  # of a page's table
RESULTS = "../../benchmarks/results"


@dataclass(frozen=True)
class Page:
    """One question. conclusion: two sentences; limits: what it does not show; contents: each JSON by its name; panels:
    of the plot, from the top; of: which pictures the plot is of; more: what follows the table; appendix: further
    tables, folded."""

    name: str
    title: str
    question: str
    table: str
    conclusion: str
    limits: str
    command: str
    contents: Mapping[str, Content]
    panels: Sequence[Draw] = ()
    of: str = ""
    more: Sequence[str] = ()
    appendix: Sequence[str] = ()

    def text(self) -> str:
        """The page in Markdown."""
        assert self.table.count("\n") <= MOST_ROWS + 1, f"the table of {self.name} has more than {MOST_ROWS} rows"
        name = ": ".join(filter(None, [self.title, self.of]))
        folded = f"<details>\n<summary>Appendix</summary>\n\n{JOIN(self.appendix)}\n\n</details>"
        return JOIN(
            [
                *(f"# {self.title}", self.question, f"**{self.conclusion}**", f"![{name}](../plots/{self.name}.svg)"),
                *(self.table, *self.more, f"## What this does not show\n\n{self.limits}{self.mixed()}"),
                f"## Reproduce it\n\n```sh\n{self.command}\n```",
                *([folded] if self.appendix else []),
                f"---\n\n{self.footer()}",
            ]
        )

    def machines(self) -> list[str]:
        """What the rows were measured on."""
        found = (content["machine"] for content in self.contents.values())
        return [*dict.fromkeys(f"{machine['processor']}, {machine['cores']} cores" for machine in found)]

    def mixed(self) -> str:
        """A line where one machine did not measure all; empty otherwise."""
        if len(self.machines()) == 1:
            return ""
        return "\n- One machine: times are of several processors, named below, and compare only within one JSON."

    def footer(self) -> str:
        """One line: rows as CSV and JSON, and when and on what they were measured."""
        files = [
            f"{name} ([CSV]({RESULTS}/csv/{name}.csv), [JSON]({RESULTS}/{name}.json)"
            f"{', by one thread' if threads_of(content) == 1 else ''})"
            for name, content in self.contents.items()
        ]
        where = self.contents.values()
        dates = sorted(content["date"][:10] for content in where)
        commits = dict.fromkeys(content["commit"] for content in where)
        when = dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"
        machines = "; ".join(self.machines())
        return (
            f"<sub>Data: {', '.join(files)}. Measured {when} on {machines}, commit {', '.join(commits)}. "
            "The JSON files also record the versions of all libraries.</sub>"
        )


def load(results: Path, name: str) -> Content | None:
    """The JSON of that name, None where it was not measured yet."""
    path = results / f"{name}.json"
    content: Content | None = json.loads(path.read_text()) if path.exists() else None
    return content


def percent(rate: float | None) -> str:
    """A difference in rate, with its sign."""
    return MISSING if rate is None else number(rate, "+.1f") + " %"


def seconds(value: float | None) -> str:
    """With two digits, or more before the point."""
    return number(value, ".2g" if value is not None and value < 10 else ".0f")


def several(words: Sequence[str]) -> str:
    """Words as a list in a sentence."""
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))
