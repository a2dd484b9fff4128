"""Time limits of profile paper."""

from __future__ import annotations

from typing import Any

import pytest

from sgmethod import encode
from sgmethod.paper import encode as paper
from tests.support.pictures import photo


@pytest.mark.parametrize(("limit_s", "attempts"), [(0.001, 1), (None, 4)])
def test_no_further_attempt_starts_after_the_limit(
    limit_s: float | None, attempts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All four started, 8.4 s for a limit of 0.3 s on a photograph: to start one takes longest."""
    began = []
    run = paper.run

    def counted(*arguments: Any) -> Any:
        began.append(arguments)
        return run(*arguments)

    monkeypatch.setattr(paper, "run", counted)
    monkeypatch.setattr(paper, "_next_count", lambda tried, *_: 50 + len(tried))  # a new number each time
    settings = paper.PaperSettings(fit_steps=2, tune_steps=2)
    encode(photo(), psnr=60, settings=settings, time_limit_s=limit_s)
    assert len(began) == attempts
