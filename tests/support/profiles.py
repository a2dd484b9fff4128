"""The profiles as tests need them: with other settings, all with short fits, and one that is not the default."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from typing import Any, cast

import pytest

from sgmethod import Budget, Encoded
from sgmethod.budget import BudgetKind
from sgmethod.codec import encode_as
from sgmethod.encode_arguments import EncodeArguments, only_budget
from sgmethod.profiles import DEFAULT_EFFORT, DEFAULT_PROFILE, PROFILE_NAMES, Settings, Tune, checked_profile, method_of
from sgmethod.trace import Progress

OTHER = next(name for name in PROFILE_NAMES if name != DEFAULT_PROFILE)


def shortened(steps: int) -> dict[str, Settings]:
    """Settings of all profiles with a fit of about so many steps."""
    return {name: import_module(f"tests.{name}.short").short(steps) for name in PROFILE_NAMES}


def shorten(monkeypatch: pytest.MonkeyPatch, steps: int) -> None:
    """Encode by these settings."""
    for name, settings in shortened(steps).items():
        monkeypatch.setattr(f"sgmethod.{name}.METHOD", replace(method_of(name), settings=settings))


def encode_with(
    settings: Settings,
    image: Any,
    budget: Budget | None = None,
    *,
    tune: Tune | None = None,
    time_limit_s: float | None = None,
    on_progress: Progress | None = None,
    measure: bool = False,
    **kind: Any,
) -> Encoded:
    """Encode as encode() does, but with these settings."""
    profile = checked_profile(settings.profile)
    only = only_budget(budget, cast(dict[BudgetKind, Any], kind))
    asked = EncodeArguments.checked(only, profile, tune, DEFAULT_EFFORT)
    return encode_as(replace(asked, settings=settings), image, time_limit_s, on_progress, measure)
