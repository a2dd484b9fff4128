"""GaussianImage's optimiser, shapes and colours (X. Zhang et al., 2024), to measure starts with as the paper does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from sgmethod.backend.protocol import Loss
from sgmethod.scene import Gaussians

INSIDE = 1 - 1e-6  # farthest place from the middle: at 1, atanh is infinite


@dataclass(frozen=True)
class AdanSettings:
    """Adan without weight decay, on means in atanh of [-1, 1], factors and colours."""

    rate: float = 1e-3
    halved_every: int = 20_000  # steps
    betas: tuple[float, float, float] = (0.98, 0.92, 0.99)
    min_scale_px: float = 0.3  # ours: kernels here need a positive one


class Adan:
    """Adan (X. Xie et al., 2022): moments of the gradient, of its change, and of the square of both together."""

    def __init__(self, settings: AdanSettings, width: int, height: int) -> None:
        """Begin with moments of zero, for Gaussians on a picture of this size in pixels."""
        self._settings, self._size, self._steps = settings, (width, height), 0
        self._moments: list[Tensor] = []

    def step(self, gaussians: Sequence[Tensor], gradient: Sequence[Tensor]) -> None:
        """Move means [..., N, 2], factors and colours [..., N, 3] in place."""
        means, factors, colors = gaussians
        half = torch.tensor(self._size, dtype=means.dtype, device=means.device) / 2
        place = (means / half - 1).clamp(-INSIDE, INSIDE)  # tanh of the parameter
        g = torch.cat([gradient[0] * half * (1 - place**2), *gradient[1:]], -1)
        if not self._moments:
            self._moments = [torch.zeros_like(g), torch.zeros_like(g), torch.zeros_like(g), g]
        first, change, square, before = self._moments
        (beta1, beta2, beta3), more = self._settings.betas, g - before
        rate = self._settings.rate * 0.5 ** (self._steps // self._settings.halved_every)
        self._steps += 1
        first.lerp_(g, 1 - beta1)
        change.lerp_(more, 1 - beta2)
        square.lerp_((g + beta2 * more).square(), 1 - beta3)
        self._moments[3] = g
        unbiased = [m / (1 - beta**self._steps) for m, beta in zip(self._moments, self._settings.betas, strict=False)]
        by = rate * (unbiased[0] + beta2 * unbiased[1]) / (unbiased[2].sqrt() + 1e-8)
        means.copy_(half * (torch.tanh(torch.atanh(place) - by[..., :2]) + 1))
        factors -= by[..., 2:5]
        factors[..., 0::2].clamp_(min=self._settings.min_scale_px)
        colors -= by[..., 5:]


def shaped(start: Gaussians, rng: np.random.Generator) -> Gaussians:
    """Give a start GaussianImage's shapes, up to a pixel and a half wide, and its colours, both random."""
    factors, colors = rng.random((len(start), 3)) + np.array([0.5, 0, 0.5]), rng.random((len(start), 3))
    return replace(start, factors=factors.astype(np.float32), colors=colors.astype(np.float32))


def fit(start: Gaussians, loss: Loss, width: int, height: int, settings: AdanSettings, steps: int) -> Gaussians:
    """Fit by Adan on the CPU."""
    gaussians, adan = start.copy(), Adan(settings, width, height)
    values = [torch.from_numpy(one) for one in gaussians.arrays]
    for _ in range(steps):
        adan.step(values, [torch.from_numpy(one) for one in loss(gaussians)[1].arrays])
    return gaussians
