"""A case: the worst figure seen under a rule, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

Found = tuple[float | None, str]  # the worst figure, None if it is no number; and what else to know


@dataclass(frozen=True)
class Case:
    """Something to try. limit: the worst figure allowed, None where the figure is only reported."""

    name: str
    rule: str
    limit: float | None
    measure: Callable[[], Found]

    def row(self) -> dict[str, Any]:
        """Try it. Whatever is raised breaks the rule."""
        try:
            worst, note = self.measure()
        except Exception as error:
            worst, note = None, f"{type(error).__name__}: {error}"
        if worst is not None and not math.isfinite(worst):
            worst = None
        kept = worst is not None and (self.limit is None or worst <= self.limit)
        verdict = "no limit" if kept and self.limit is None else "kept" if kept else "broken"
        tried = {"case": self.name, "rule": self.rule, "limit": self.limit}
        return {**tried, "worst": worst, "verdict": verdict, "note": note}


Cases = Iterator[Case]
