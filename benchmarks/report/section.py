"""What a section of the document is made of."""

from __future__ import annotations

import json
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.machine import in_words

Content = dict[str, Any]  # of a JSON
Draw = Callable[[Any], None]  # on the axes of matplotlib
MISSING = "-"


@dataclass(frozen=True)
class Section:
    """One question. said: what was asked, what came out, what it does not show; contents: the JSON of each table and
    plot; panels: of its plot, if there is one, from the top; of: which pictures and files the plot is of; how: what
    else a reader of the tables must know of the way in which they were measured."""

    name: str
    title: str
    said: str
    tables: Sequence[str]
    contents: Sequence[Content]
    panels: Sequence[Draw] = ()
    of: str = ""
    how: str = ""

    def text(self) -> str:
        """Markdown."""
        name = ": ".join(filter(None, [self.title, self.of]))
        plot = [f"![{name}](plots/{self.name}.svg)"] if self.panels else []
        how = [f"How it was measured: {self.how}"] if self.how else []
        return "\n\n".join([f"## {self.title}", self.said, *plot, *self.tables, *how, *map(origin, self.contents)])


def origin(content: Content) -> str:
    """By which command, where and when; and what else must be known."""
    remark = f" {content['remark']}" if content.get("remark") else ""
    libraries = ", ".join(content.get("settings", {}).get("codecs", ()))
    versions = f" With {libraries}." if libraries else ""
    packages = content["machine"]["packages"].items()
    ours = ", ".join([f"Python {content['machine']['python']}", *(f"{name} {has}" for name, has in packages if has)])
    return f"`{content['command']}`: {in_words(content)}; {ours}.{versions}{remark}"


def load(results: Path, name: str) -> Content | None:
    """The JSON of that name, None where it was not measured yet."""
    path = results / f"{name}.json"
    content: Content | None = json.loads(path.read_text()) if path.exists() else None
    return content


def table(titles: str, rows: Sequence[Sequence[object]]) -> str:
    """Markdown; titles separated by bars."""
    names = [title.strip() for title in titles.split("|")]
    lines = [names, ["---"] * len(names), *[[str(cell) for cell in row] for row in rows]]
    return (
        "\n".join("| " + " | ".join(line) + " |" for line in lines).replace("| --- ", "|---").replace("--- |", "---|")
    )


def folded(title: str, text: str) -> str:
    """What few want to see: behind a line that opens it."""
    return f"<details>\n<summary>{title}</summary>\n\n{text}\n\n</details>"


def mean(values: Sequence[float | None]) -> float | None:
    """None where there is none, or one is missing."""
    known = [value for value in values if value is not None]
    return statistics.fmean(known) if known and len(known) == len(values) else None


def number(value: float | None, form: str) -> str:
    """With so many digits, or a dash. What rounds to nothing has no sign of a loss."""
    if value is None:
        return MISSING
    rounded = format(value, form)
    return rounded if set(rounded) - set("+-0.,") else format(abs(value), form)
