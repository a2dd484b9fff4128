"""Groups of settings shared by several profiles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol, get_args

Tune = Literal["psnr", "fidelity", "visual"]
TUNES: tuple[Tune, ...] = get_args(Tune)


class Settings(Protocol):
    """All numbers of a profile."""

    profile: ClassVar[str]


@dataclass(frozen=True)
class OptimiserSettings:
    """Settings of Adam in each Gaussian's own frame (ours). Rates are relative changes per step."""

    mean_rate: float = 0.07
    factor_rate: float = 0.07
    color_rate: float = 0.035
    final_rate: float = 0.03  # factor on the rates at the end of the cosine schedule
    beta1: float = 0.9
    beta2: float = 0.99
    newton_steps: float = math.inf  # longest step, in steps of Gauss-Newton with a diagonal matrix
    min_scale_px: float = 0.3  # least l1 and l3: a smaller Gaussian falls between pixel centres


ADAM = OptimiserSettings()
