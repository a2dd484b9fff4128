"""Schedule of a fit of exactly N Gaussians in floating point. Times are fractions of the run, 0 to 1."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sgmethod.settings.rd import RdSettings


@dataclass(frozen=True)
class ExactSettings:
    """Shares of a run in which Gaussians come and go."""

    share_of_steps: float = 0.6  # default steps, as a part of an effort's: nothing has to be rounded
    steps_of_growth: int = 40  # between two growths
    fewest_growths: int = 4
    growth_until: float = 0.6
    trims: int = 8
    trim_until: float = 0.8
    excess: float = 0.5
    # Quantum that prices bits until the last trim, in multiples of that at which growth would find as many Gaussians.
    price: float = 0.8
    few_until: float = 0.3  # Times.few_until
    final_rate: tuple[float, float] = (0.1, 0.5)  # of many and of few steps
    few_steps: float = 75.0  # divided by the number of steps, this is the final rate


EXACT = ExactSettings()


def exact_schedule(settings: RdSettings, steps: int, exact: ExactSettings = EXACT) -> RdSettings:
    """Adapt settings to a fit of so many steps."""
    growths = max(round(exact.growth_until * steps / exact.steps_of_growth), exact.fewest_growths)
    times = replace(
        settings.effort.times,
        growth_at=tuple(np.linspace(0.01, exact.growth_until, growths).tolist()),
        trim_at=tuple(np.linspace(exact.growth_until + 0.02, exact.trim_until, exact.trims).tolist()),
        excess=exact.excess,
        excess_from=0.7 * exact.growth_until,
        excess_until=exact.trim_until,
        few_until=exact.few_until,
    )
    rate = min(max(exact.few_steps / steps, exact.final_rate[0]), exact.final_rate[1])
    optimiser = replace(settings.fit.optimiser, final_rate=rate)
    return replace(
        settings,
        effort=replace(settings.effort, steps=steps, times=times, rounds=(0,)),
        fit=replace(settings.fit, optimiser=optimiser),
    )
