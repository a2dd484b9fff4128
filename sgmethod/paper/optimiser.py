"""The optimisers of the fits: ours, which is profile rd's Adam, and Adan, which GaussianImage uses."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from sgmethod.backend.protocol import Moments
from sgmethod.fitting.deadline import cosine
from sgmethod.fitting.level import Level
from sgmethod.scene import Gaussians
from sgmethod.settings.paper import AdanSettings
from sgmethod.settings.shared import OptimiserSettings

Move = Callable[[Gaussians, Gaussians, float], None]  # Gaussians, moved in place; their gradient; factor on the rates
INSIDE = 1 - 1e-6  # farthest place from the middle: at 1, atanh is infinite


def rate_at(settings: OptimiserSettings | AdanSettings, progress: float, steps: int) -> float:
    """Factor on the rates at a part, 0 to 1, of a schedule of so many steps."""
    if isinstance(settings, AdanSettings):
        return 0.5 ** int(progress * steps / settings.halved_every)
    return cosine(settings.final_rate, progress)


def mover(settings: OptimiserSettings | AdanSettings, level: Level, n: int) -> Move:
    """Build the function that moves n Gaussians by a step."""
    if isinstance(settings, AdanSettings):
        adan = Adan(settings, level.frame.width, level.frame.height)

        def move(gaussians: Gaussians, gradient: Gaussians, rate: float) -> None:
            values, by_values = ([torch.from_numpy(one) for one in of.arrays] for of in (gaussians, gradient))
            adan.step(values, by_values, rate)

        return move
    moments = Moments.none(n)
    return lambda gaussians, gradient, rate: level.backend.step(gaussians, gradient, moments, settings, rate, 1)


class Adan:
    """Adan (X. Xie et al., 2022): moments of the gradient, of its change, and of the square of both together."""

    def __init__(self, settings: AdanSettings, width: int, height: int) -> None:
        """Begin with moments of zero, for Gaussians on a picture of this size in pixels."""
        self._settings, self._size, self._steps = settings, (width, height), 0
        self._moments: list[Tensor] = []

    def step(self, gaussians: Sequence[Tensor], gradient: Sequence[Tensor], rate: float) -> None:
        """Move means [..., N, 2], factors and colours [..., N, 3] in place. rate: factor on the settings' rate."""
        means, factors, colors = gaussians
        half = torch.tensor(self._size, dtype=means.dtype, device=means.device) / 2
        place = (means / half - 1).clamp(-INSIDE, INSIDE)  # tanh of the parameter
        g = torch.cat([gradient[0] * half * (1 - place**2), *gradient[1:]], -1)
        if not self._moments:
            self._moments = [torch.zeros_like(g), torch.zeros_like(g), torch.zeros_like(g), g]
        first, change, square, before = self._moments
        (beta1, beta2, beta3), more = self._settings.betas, g - before
        self._steps += 1
        first.lerp_(g, 1 - beta1)
        change.lerp_(more, 1 - beta2)
        square.lerp_((g + beta2 * more).square(), 1 - beta3)
        self._moments[3] = g
        unbiased = [m / (1 - beta**self._steps) for m, beta in zip(self._moments, self._settings.betas, strict=False)]
        by = rate * self._settings.rate * (unbiased[0] + beta2 * unbiased[1]) / (unbiased[2].sqrt() + 1e-8)
        means.copy_(half * (torch.tanh(torch.atanh(place) - by[..., :2]) + 1))
        factors -= by[..., 2:5]
        factors[..., 0::2].clamp_(min=self._settings.min_scale_px)
        colors -= by[..., 5:]
