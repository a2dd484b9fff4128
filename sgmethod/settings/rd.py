"""Efforts of profile rd (ours). Times are fractions of a run of the schedule, 0 to 1."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from sgmethod.settings.shared import OptimiserSettings

# newton_steps shortens the steps, so rates may be high and need not fall much.
NEWTON_ADAM = OptimiserSettings(
    mean_rate=0.14, factor_rate=0.14, color_rate=0.14, final_rate=0.5, newton_steps=2.0, min_scale_px=0.5
)


@dataclass(frozen=True)
class Times:
    """Times of events in one run of profile rd's schedule."""

    # Gaussians are added at these times, wherever one gains more than its bits are worth.
    growth_at: tuple[float, ...] = (0.03, 0.09, 0.15, 0.21, 0.27, 0.33, 0.39, 0.45, 0.55, 0.65)
    # The quantum moves towards the requested size or PSNR at the times of growth and at these.
    trim_at: tuple[float, ...] = (0.72, 0.78, 0.82, 0.86, 0.9, 0.94, 0.97, 0.99)
    steering_from: float = 0.12
    early_db: float = 2.0  # when steering begins, it aims this far below the final quality
    quality_at: tuple[float, ...] = (0.33, 0.65, 0.86)  # few, because measuring takes as long as several steps

    # Surplus over the budget at first, given up between these times.
    excess: float = 0.5  # a budget of 100 bytes, or Gaussians, allows 150 at first
    finer_early: float = 4.0  # a quantum set by the budget is divided by this at first
    excess_from: float = 0.45
    excess_until: float = 0.88

    # The end of the time with few pixels, and the start of the time with many (fitting/level.py).
    few_until: float = 0.6
    many_from: float = 0.85
    # Before a file is made, the price of a bit falls from this stage on: it has decided which Gaussians stay, and would
    # only keep their colours too faint.
    settling_from: float = 0.97
    # A fit comes apart if one step multiplies its error by this, as where many wide Gaussians overlap: it then takes
    # that stage's steps again, shorter, as all later ones.
    apart: float = math.inf


# Effort 1: few growths, no surplus, and smaller pictures for longer.
QUICK = Times(
    growth_at=(0.03, 0.1, 0.2, 0.32, 0.46, 0.6),
    trim_at=(0.72, 0.8, 0.88, 0.94, 0.98),
    excess=0.0,
    few_until=0.85,
    quality_at=(0.2, 0.32, 0.46, 0.6, 0.88),
    early_db=-0.5,  # few growths begin slowly on a large picture; a coarser quantum takes back what is too much
    apart=1.5,  # so few steps leave no time to recover; 1.25 would end many fits that recover
)
# Effort 2: the same with two growths more, and a surplus.
BRISK = replace(
    QUICK,
    growth_at=(0.03, 0.09, 0.15, 0.22, 0.3, 0.38, 0.48, 0.6),
    quality_at=(0.15, 0.3, 0.48, 0.6, 0.88),
    excess=0.25,
)

# A round after the first run: more Gaussians than fit are added to a file of full size, and those that gain least for
# their bits are dropped.
ROUND = Times(
    growth_at=(0.0, 0.1, 0.2),
    quality_at=(0.5, 0.88),
    trim_at=(0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.88, 0.94, 0.98),
    steering_from=0.0,
    early_db=0.0,
    excess=1.0,
    finer_early=1.35,
    excess_from=0.0,
    excess_until=0.6,
    few_until=0.0,
    apart=1.25,  # it has no time to recover, as the first run has, where long steps gain more than they lose
)


@dataclass(frozen=True)
class Effort:
    """A level of effort of profile rd. Each above the default does all that the one below does, and then goes on."""

    steps: int = 250  # of the first run of the schedule
    times: Times = Times()
    rounds: tuple[int, ...] = (1,)  # rounds after the first run at which a file is made; the best file is kept
    # Coarser sizes whose gains can hide a place of growth: all, if the target does not move. Few for the eye, as growth
    # does not see that coarse errors count more.
    suppression_levels: int = 8
    suppression_levels_for_eye: int = 2
    refine_sweeps: int = 2  # over all Gaussians
    size_tries: int = 4  # further files with finer quanta, if refining leaves bytes unused


EFFORTS: dict[int, Effort] = {
    1: Effort(120, QUICK, (0,), suppression_levels=1, suppression_levels_for_eye=1, refine_sweeps=0, size_tries=0),
    2: Effort(120, BRISK, (0,), suppression_levels=2, refine_sweeps=1, size_tries=1),
    3: Effort(180, rounds=(0,)),
    4: Effort(rounds=(0,)),
    5: Effort(),
    6: Effort(rounds=(1, 2)),
    7: Effort(rounds=(1, 2, 5)),
    8: Effort(rounds=(1, 2, 5, 12)),
    9: Effort(rounds=(1, 2, 5, 12, 20)),
}
DEFAULT_EFFORT = 5
EFFORTS_BY_SIZE = ((2e6, DEFAULT_EFFORT), (6e6, 3), (math.inf, 2))  # pixels at most, and the default effort up to them


def default_effort(pixels: int) -> int:
    """Return the default effort of a picture of this many pixels."""
    return next(effort for most, effort in EFFORTS_BY_SIZE if pixels <= most)


@dataclass(frozen=True)
class RdSettings:
    """The settings of profile rd."""

    profile: ClassVar[str] = "rd"
    effort: Effort = EFFORTS[DEFAULT_EFFORT]
    optimiser: OptimiserSettings = NEWTON_ADAM


RD = RdSettings()
