"""The profiles as tests need them: all with short fits, and one that is not the default."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

import pytest

from sgmethod.profiles import DEFAULT_PROFILE, PROFILE_NAMES, Settings, method_of

OTHER = next(name for name in PROFILE_NAMES if name != DEFAULT_PROFILE)


def shortened(steps: int) -> dict[str, Settings]:
    """Settings of all profiles with a fit of about so many steps."""
    return {name: import_module(f"tests.{name}.short").short(steps) for name in PROFILE_NAMES}


def shorten(monkeypatch: pytest.MonkeyPatch, steps: int) -> None:
    """Encode by these settings."""
    for name, settings in shortened(steps).items():
        monkeypatch.setattr(f"sgmethod.{name}.METHOD", replace(method_of(name), settings=settings))
