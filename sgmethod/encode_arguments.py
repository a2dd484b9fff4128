"""The options of an encode in one table, and their check, for every program that takes them."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, fields, replace
from typing import Any

from sgmethod import profiles
from sgmethod.arguments import AnyFloat, AnyInt, finite_number
from sgmethod.budget import DEFAULT_BUDGET, Budget, BudgetKind, default_budget
from sgmethod.errors import BudgetError
from sgmethod.profiles import Profile, Settings, Tune


def _option(default: Any, text: str, **schema: Any) -> Any:
    """Return an option. text: its help; schema: what it may be, in words of JSON Schema. pydantic reads both."""
    return field(default=default, metadata={"description": text, "json_schema_extra": schema})


@dataclass(frozen=True, kw_only=True)
class EncodeOptions:
    """The options of an encode besides its budget: of the command line, of the service's requests, and of its jobs.

    Their values are checked by EncodeArguments.
    """

    profile: str = _option(
        profiles.DEFAULT_PROFILE, f"method (default: {profiles.DEFAULT_PROFILE})", enum=[*profiles.PROFILE_NAMES]
    )
    tune: str | None = _option(
        None,
        "visual looks best, fidelity is that without synthesised grain, psnr has the least squared error "
        f"(default: {profiles.DEFAULT_TUNE}; with a budget in dB: psnr)",
        enum=[*profiles.TUNES],
    )
    effort: int | None = _option(
        None,
        f"{min(profiles.EFFORTS)} is fastest, {max(profiles.EFFORTS)} gives the best file "
        f"(default: {profiles.DEFAULT_EFFORT}, less for large pictures); profile rd only",
        minimum=min(profiles.EFFORTS),
        maximum=max(profiles.EFFORTS),
    )
    time_limit_s: float | None = _option(
        None, "time limit in seconds for each picture (default: none, or the longest that a server allows)"
    )

    def options(self) -> dict[str, Any]:
        """Return the options by name, as encode() takes them."""
        return {one.name: getattr(self, one.name) for one in fields(EncodeOptions)}


@dataclass(frozen=True)
class EncodeArguments:
    """The checked arguments of an encode. settings: those of profile and effort, unless replaced."""

    budget: Budget
    profile: Profile
    tune: Tune
    effort: int | None
    settings: Settings

    @classmethod
    def checked(cls, budget: Budget, profile: str, tune: str | None, effort: AnyInt | None) -> EncodeArguments:
        """Check the arguments of encode(). Raises BudgetError."""
        profile = profiles.checked_profile(profile)
        if budget is not DEFAULT_BUDGET:
            profiles.check_kind(budget, profile)
        tuned_for = profiles.tuning(tune, profile, budget)
        effort = None if effort is None else profiles.checked_effort(effort)
        return cls(budget, profile, tuned_for, effort, profiles.settings_of(profile, effort or profiles.DEFAULT_EFFORT))

    @property
    def objective(self) -> Tune:
        """What the fit is tuned for. SSIMULACRA 2, which is what a quality means, counts texture as an error."""
        return "fidelity" if self.tune == "visual" and self.budget.kind == "quality" else self.tune

    def for_size(self, width: int, height: int, *, has_alpha: bool) -> EncodeArguments:
        """Replace the default budget and effort by what they are for a picture of this size."""
        from sgmethod.metrics.visual import SMALLEST_SIDE

        asked = self
        if asked.effort is None:
            effort = profiles.default_effort(asked.profile, width * height)
            asked = replace(asked, effort=effort, settings=profiles.settings_of(asked.profile, effort))
        if asked.budget is not DEFAULT_BUDGET:
            return asked
        has_quality = "quality" in profiles.method_of(asked.profile).kinds and min(width, height) >= SMALLEST_SIDE
        least = profiles.smallest_file(asked.settings, has_alpha=has_alpha)
        return replace(asked, budget=default_budget(width, height, least, has_quality=has_quality))

    def check_size(self, width: int, height: int) -> None:
        """Raise BudgetError if no file of a picture of this size, without alpha, could meet the budget."""
        from sgmethod.metrics.visual import SMALLEST_SIDE

        budget, least = self.budget, profiles.smallest_file(self.settings)
        if budget.kind == "gaussians":
            budget.max_gaussians(width, height)
        if budget.kind == "quality" and min(width, height) < SMALLEST_SIDE:
            raise BudgetError(f"quality is undefined for sides below {SMALLEST_SIDE} pixels")
        allowed = budget.max_bytes(width, height)
        if allowed is not None and allowed < least:
            raise BudgetError(f"a file of profile {self.profile} takes at least {least} bytes, the budget is {allowed}")


def only_budget(budget: Budget | None, kinds: dict[BudgetKind, Any]) -> Budget:
    """Return the budget given, or the default. Raises BudgetError for more than one."""
    given = [Budget(kind, value) for kind, value in kinds.items() if value is not None]
    if budget is not None:
        if not isinstance(budget, Budget):
            raise BudgetError(f"a budget must be a sgmethod.Budget, not {type(budget).__name__}; or use bpp=0.3")
        given.append(budget)
    if len(given) > 1:
        raise BudgetError(f"give one budget, not {len(given)}: {', '.join(one.kind for one in given)}")
    return given[0] if given else DEFAULT_BUDGET


def checked_time_limit(seconds: AnyFloat | None) -> float | None:
    """Return a time limit in seconds. Raises BudgetError for anything but a positive number."""
    if seconds is None:
        return None
    number = finite_number(seconds)
    if number is None or not 0 < number <= sys.float_info.max:
        raise BudgetError(f"the time limit must be a positive number of seconds, got {seconds!r}")
    return float(number)
