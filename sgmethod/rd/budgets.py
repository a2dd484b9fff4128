"""The kind of rate control for each kind of budget."""

from __future__ import annotations

from sgmethod.budget import Budget
from sgmethod.rd.aim import PsnrAim, QualityAim
from sgmethod.rd.byte_limit import ByteBudget
from sgmethod.rd.rate_control import GaussianCount, RateControl
from sgmethod.settings.rd import RdSettings


def rate_of(budget: Budget, size: tuple[int, int], settings: RdSettings, *, has_alpha: bool = False) -> RateControl:
    """Create rate control for a picture of size (width, height). Raises BudgetError if no file can meet the budget."""
    pixels = size[0] * size[1]
    match budget.kind:
        case "gaussians":
            limit, quantum = budget.max_gaussians(*size), settings.rate.gaussians_quantum
            return GaussianCount(settings.rate, pixels, quantum, max_gaussians=limit)
        case "psnr":
            return PsnrAim.from_psnr(budget.value, pixels, settings)
        case "quality":
            return QualityAim.from_score(budget.value, size, settings)
    return ByteBudget.from_bytes(budget.max_bytes(*size) or 0, pixels, settings, has_alpha=has_alpha)
