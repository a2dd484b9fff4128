"""The arguments of an encode, checked before anything is read."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from typing import Any

from sgmethod import profiles
from sgmethod.arguments import AnyFloat, AnyInt, finite_number
from sgmethod.budget import DEFAULT_BUDGET, Budget, BudgetKind, default_budget
from sgmethod.errors import BudgetError
from sgmethod.profiles import Profile, Settings, Tune
from sgmethod.scene import Pixels


@dataclass(frozen=True)
class EncodeArguments:
    """The checked arguments of an encode. effort: None if the caller gave settings."""

    budget: Budget
    profile: Profile
    tune: Tune
    effort: int | None
    settings: Settings

    @classmethod
    def checked(
        cls,
        budget: Budget,
        profile: Profile,
        tune: Tune | None,
        effort: AnyInt,
        settings: Settings | None,
    ) -> EncodeArguments:
        """Check the arguments of encode(). Raises BudgetError."""
        profile = profiles.checked_profile(profile if settings is None else settings.profile)
        profiles.check_kind(budget, profile)
        tuned_for = profiles.tuning(tune, profile, budget)
        if settings is not None:
            return cls(budget, profile, tuned_for, None, settings)
        effort = profiles.checked_effort(effort)
        return cls(budget, profile, tuned_for, effort, profiles.settings_of(profile, effort))

    @property
    def objective(self) -> Tune:
        """What the fit is tuned for. SSIMULACRA 2, which is what a quality means, counts texture as an error."""
        return "fidelity" if self.tune == "visual" and self.budget.kind == "quality" else self.tune

    def with_default_for(self, pixels: Pixels) -> EncodeArguments:
        """Replace the default budget by what it is for a picture [H, W, C]."""
        if self.budget is not DEFAULT_BUDGET:
            return self
        height, width, channels = pixels.shape
        least = profiles.smallest_file(self.settings, has_alpha=channels == 4)
        return replace(self, budget=default_budget(width, height, least))


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
