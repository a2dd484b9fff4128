"""Encodes of a fraction of a second."""

from __future__ import annotations

from dataclasses import replace

from sgmethod.paper.settings import PAPER, PaperSettings


def short(steps: int) -> PaperSettings:
    """The settings with shorter phases, half of `steps` steps in all."""
    return replace(PAPER, fit_steps=3 * steps // 10, tune_steps=steps // 5)
