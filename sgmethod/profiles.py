"""Profiles, tunings and efforts by name, without PyTorch, because the service validates with this module."""

from __future__ import annotations

from dataclasses import replace
from numbers import Integral
from typing import Literal, get_args

from sgmethod.budget import Budget
from sgmethod.errors import BudgetError
from sgmethod.settings.paper import PAPER, PaperSettings
from sgmethod.settings.rd import DEFAULT_EFFORT, EFFORTS, RD, RdSettings
from sgmethod.settings.shared import TUNES, Tune

__all__ = [
    "DEFAULT_EFFORT",
    "DEFAULT_PROFILE",
    "DEFAULT_TUNE",
    "EFFORTS",
    "PROFILES",
    "PROFILE_NAMES",
    "TUNES",
    "Profile",
    "Settings",
    "Tune",
    "checked_effort",
    "checked_profile",
    "profile_of",
    "settings_of",
    "tuning",
]

Profile = Literal["rd", "paper"]
Settings = RdSettings | PaperSettings
PROFILES: dict[str, Settings] = {"rd": RD, "paper": PAPER}
PROFILE_NAMES: tuple[Profile, ...] = get_args(Profile)
DEFAULT_PROFILE: Profile = "rd"
DEFAULT_TUNE: Tune = "visual"  # if profile and budget allow both


def checked_profile(profile: str) -> Profile:
    """Return `profile` if it is one of PROFILE_NAMES. Raises BudgetError for anything else."""
    if not isinstance(profile, str) or profile not in PROFILES:
        raise BudgetError(f"unknown profile {profile!r}; use one of {', '.join(PROFILES)}")
    return PROFILE_NAMES[PROFILE_NAMES.index(profile)]


def tuning(tune: str | None, profile: str, budget: Budget) -> Tune:
    """Return the requested tuning, or the default for this profile and budget.

    Raises BudgetError for an unknown one, and for one other than "psnr" with a budget in dB or a
    profile other than rd.
    """
    psnr_alone = budget.kind == "psnr" or profile != "rd"
    if tune is None:
        return "psnr" if psnr_alone else DEFAULT_TUNE
    if tune not in TUNES:
        raise BudgetError(f"unknown tune {tune!r}; use one of {', '.join(TUNES)}")
    if tune != "psnr" and psnr_alone:
        what = "a budget in dB" if budget.kind == "psnr" else f"profile {profile}"
        raise BudgetError(f"{what} can only be tuned for psnr")
    return TUNES[TUNES.index(tune)]


def checked_effort(effort: object) -> int:
    """Return `effort` as an int if it is one of EFFORTS. Raises BudgetError for anything else."""
    if isinstance(effort, bool) or not isinstance(effort, Integral) or effort not in EFFORTS:
        raise BudgetError(f"effort must be a whole number from {min(EFFORTS)} to {max(EFFORTS)}, got {effort!r}")
    return int(effort)


def settings_of(profile: str, effort: int) -> Settings:
    """Return a profile's settings. Raises BudgetError for a non-default effort of profiles other than rd."""
    settings = PROFILES[profile]
    if isinstance(settings, RdSettings):
        return settings if effort == DEFAULT_EFFORT else replace(settings, effort=EFFORTS[effort])
    if effort != DEFAULT_EFFORT:
        raise BudgetError("only profile rd has an effort")
    return settings


def profile_of(settings: Settings) -> Profile:
    """Return the profile that settings belong to."""
    return "rd" if isinstance(settings, RdSettings) else "paper"
