"""Schedule of a fit of exactly N Gaussians in floating point. Times are fractions of the run, 0 to 1."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sgmethod.settings.rd import RD, RdSettings


@dataclass(frozen=True)
class ExactSettings:
    """Shares of a run in which Gaussians come and go."""

    share_of_steps: float = 0.6  # default steps, as a part of an effort's: nothing has to be rounded
    steps_of_growth: int = 40  # between two; in 4,000 steps, 60 growths make 0.2 dB more than ten and a longer rest
    min_growths: int = 5
    growth_until: float = 0.6
    trims: int = 8
    trim_until: float = 0.8
    # Quantum that prices bits until the last trim, in multiples of that at which growth would find as many Gaussians;
    # at most that of an encode of as many, because few Gaussians on a smooth picture cannot pay for more.
    price: float = 0.8
    few_until: float = 0.3  # Times.few_until
    final_rate: tuple[float, float] = (0.1, 0.5)  # of many and of few steps
    few_steps: float = 75.0  # divided by the number of steps, this is the final rate


EXACT = ExactSettings()


def exact_schedule(steps: int) -> RdSettings:
    """Adapt the settings of profile rd to a fit of this many steps."""
    growths = max(round(EXACT.growth_until * steps / EXACT.steps_of_growth), EXACT.min_growths)
    times = replace(
        RD.effort.times,
        growth_at=tuple(np.linspace(0.01, EXACT.growth_until, growths).tolist()),
        trim_at=tuple(np.linspace(EXACT.growth_until + 0.02, EXACT.trim_until, EXACT.trims).tolist()),
        excess_from=0.7 * EXACT.growth_until,
        excess_until=EXACT.trim_until,
        few_until=EXACT.few_until,
    )
    low, high = EXACT.final_rate
    optimiser = replace(RD.optimiser, final_rate=min(max(EXACT.few_steps / steps, low), high))
    effort = replace(RD.effort, steps=steps, times=times, rounds=(0,))
    return replace(RD, effort=effort, optimiser=optimiser)
