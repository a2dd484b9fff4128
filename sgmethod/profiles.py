"""Profiles, tunings and efforts by name, without PyTorch, because the service validates with this module."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from numbers import Integral
from typing import Any, Literal, cast, get_args

from sgmethod.budget import BUDGET_KINDS, Budget, BudgetKind
from sgmethod.errors import BudgetError, extra
from sgmethod.settings import rd, shared

Settings = shared.Settings
Tune = shared.Tune
TUNES, EFFORTS, DEFAULT_EFFORT = shared.TUNES, rd.EFFORTS, rd.DEFAULT_EFFORT
Profile = Literal["rd", "paper"]
PROFILE_NAMES: tuple[Profile, ...] = get_args(Profile)
DEFAULT_PROFILE: Profile = "rd"
DEFAULT_TUNE: Tune = "visual"  # if profile and budget allow both
READERS = {1: "sgmethod.paper.stream.PaperStream", 2: "sgmethod.bitstream.v2.StreamV2"}  # by a file's version


@dataclass(frozen=True)
class Method:
    """What a profile knows, and where its larger parts are: METHOD of the package sgmethod.NAME."""

    settings: Settings
    encoder: str  # the function that encodes
    smallest_file: str  # (settings, has_alpha) -> bytes of the smallest file for the largest picture
    tunes: tuple[Tune, ...] = TUNES
    kinds: tuple[BudgetKind, ...] = BUDGET_KINDS
    keeps_alpha: bool = True
    packages: tuple[str, ...] = ()  # of the extra torch, which the encoder needs


def method_of(profile: str) -> Method:
    """Import a profile's method, which imports neither its encoder nor PyTorch."""
    return cast(Method, imported(f"sgmethod.{profile}.METHOD"))


def encoder_of(profile: str) -> Callable[..., tuple[bytes, int]]:
    """Import a profile's encoder. Raises MissingPackageError."""
    method = method_of(profile)
    with extra("torch"):
        for package in method.packages:
            import_module(package)
    return cast(Callable[..., tuple[bytes, int]], imported(method.encoder))


def imported(path: str) -> Any:
    """Import a name from a module, given both."""
    module, _, name = path.rpartition(".")
    return getattr(import_module(module), name)


def checked_profile(profile: str) -> Profile:
    """Return `profile` if it is one of PROFILE_NAMES. Raises BudgetError for anything else."""
    if not isinstance(profile, str) or profile not in PROFILE_NAMES:
        raise BudgetError(f"unknown profile {profile!r}; use one of {', '.join(PROFILE_NAMES)}")
    return PROFILE_NAMES[PROFILE_NAMES.index(profile)]


def check_kind(budget: Budget, profile: str) -> None:
    """Raise BudgetError for a budget of a kind that the profile does not know."""
    *kinds, last = method_of(profile).kinds
    if budget.kind not in (*kinds, last):
        raise BudgetError(f"profile {profile} cannot aim at a {budget.kind}; use {', '.join(kinds)} or {last}")


def tuning(tune: str | None, profile: str, budget: Budget) -> Tune:
    """Return the requested tuning, or the default for this profile and budget.

    Raises BudgetError for an unknown one, and for one that the profile lacks or, with a budget in dB, other than
    "psnr".
    """
    known: tuple[Tune, ...] = ("psnr",) if budget.kind == "psnr" else method_of(profile).tunes
    if tune is None:
        return DEFAULT_TUNE if DEFAULT_TUNE in known else "psnr"
    if tune not in TUNES:
        raise BudgetError(f"unknown tune {tune!r}; use one of {', '.join(TUNES)}")
    if tune not in known:
        what = "a budget in dB" if budget.kind == "psnr" else f"profile {profile}"
        raise BudgetError(f"{what} can only be tuned for psnr")
    return TUNES[TUNES.index(tune)]


def checked_effort(effort: object) -> int:
    """Return `effort` as an int if it is one of EFFORTS. Raises BudgetError for anything else."""
    if isinstance(effort, bool) or not isinstance(effort, Integral) or effort not in EFFORTS:
        raise BudgetError(f"effort must be a whole number from {min(EFFORTS)} to {max(EFFORTS)}, got {effort!r}")
    return int(effort)


def default_effort(profile: str, pixels: int) -> int:
    """Return the effort for a picture of this many pixels if none is asked for."""
    return rd.default_effort(pixels) if profile == DEFAULT_PROFILE else DEFAULT_EFFORT


def settings_of(profile: str, effort: int) -> Settings:
    """Return a profile's settings. Raises BudgetError for a non-default effort of a profile that has none."""
    settings = method_of(profile).settings
    if effort == DEFAULT_EFFORT:
        return settings
    if not isinstance(settings, rd.RdSettings):
        raise BudgetError("only profile rd has an effort")
    return replace(settings, effort=EFFORTS[effort])


def smallest_file(settings: Settings, *, has_alpha: bool = False) -> int:
    """Bytes of the smallest file that a profile writes for the largest picture."""
    return int(imported(method_of(settings.profile).smallest_file)(settings, has_alpha))
