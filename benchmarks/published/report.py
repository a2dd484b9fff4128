"""What profile rd needs against the best of the published codecs."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.rd.report import ONE_QUALITY, Row, against_quoted, means

BEST = ("VTM", "ELIC", "Cheng 2020, attention", "HM", "AV1 (libaom)")  # each of one quality for all pictures


def ahead(rows: Sequence[Row]) -> dict[str, float | None]:
    """BD-rates of rd against each, in percent. rows: of one quality for all pictures, as theirs are."""
    average = means(rows)
    return {other.replace(", ", " with "): against_quoted(average, f"rd {ONE_QUALITY}", other) for other in BEST}
