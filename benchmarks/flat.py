"""The rows of a JSON as CSV: means over pictures and seeds."""

from __future__ import annotations

import csv
import io
import statistics
from collections.abc import Iterator, Sequence
from typing import Any

Row = dict[str, Any]
AVERAGED = ("image", "picture", "seed")  # over these
# The columns that identify a line; they come first.
KEYS = (
    *("codec", "anchor", "max_bpp", "quality", "kind", "megapixels", "max_bytes", "method", "setting", "what", "asked"),
    *("job", "isa", "threads", "table", "without", "set", "case", "rule", "value", "attack", "database"),
)


def flat(rows: Sequence[Row], apart: str = "") -> str:
    """Rows as CSV. apart: one more column that identifies a line."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    keys = [name for name in (apart, *KEYS) if any(name in row for row in rows)]
    for row in rows:
        groups.setdefault(tuple(row.get(name) for name in keys), []).append(dict(_cells(row)))
    lines = []
    for key, group in groups.items():
        line: Row = dict(zip(keys, key, strict=True)) | {"rows": len(group)}
        for name in dict.fromkeys(name for row in group for name in row):
            if name not in (*keys, *AVERAGED):
                line[name] = _one([row.get(name) for row in group])
        lines.append(line)
    titles = list(dict.fromkeys(name for line in lines for name in line if line[name] is not None))
    file = io.StringIO()
    writer = csv.DictWriter(file, titles, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return file.getvalue()


def _cells(row: Row, before: str = "") -> Iterator[tuple[str, Any]]:
    """Numbers and words of a row, and the median of repeated times; no curves."""
    for name, value in row.items():
        if isinstance(value, dict):
            yield from _cells(value, f"{before}{name} ")
        elif isinstance(value, list):
            if value and all(isinstance(one, float | int) for one in value):
                yield before + name, statistics.median(value)
            elif all(isinstance(one, str) for one in value):
                yield before + name, "; ".join(value)
        else:
            yield before + name, value


def _one(values: Sequence[Any]) -> Any:
    """The mean, if all are numbers; else the word that all share."""
    if all(isinstance(value, float | int) and not isinstance(value, bool) for value in values):
        return f"{statistics.fmean(values):.6g}"
    return values[0] if len({*values}) == 1 else None
