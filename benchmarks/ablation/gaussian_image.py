"""GaussianImage's optimiser, shapes and colours (X. Zhang et al., 2024), to measure starts with as the paper does.

A part of a picture is fitted in the units of the whole: a step moves a mean by a part of the whole picture's side, and
a gradient stands as far above Adan's eps as it does there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from sgmethod.backend.protocol import CUTOFF_V1
from sgmethod.native import native
from sgmethod.scene import Gaussians

GradientOf = Callable[[Tensor, Tensor], Tensor]  # of pictures [B, 3, H, W] and their targets, by the pictures
INSIDE = 1 - 1e-6  # farthest place from the middle: at 1, atanh is infinite
WHOLE = (768, 512)  # width and height of the photographs of Kodak


@dataclass(frozen=True)
class AdanSettings:
    """Adan without weight decay, on means in atanh of [-1, 1], factors and colours."""

    rate: float = 1e-3
    halved_every: int = 20_000  # steps
    betas: tuple[float, float, float] = (0.98, 0.92, 0.99)
    eps: float = 1e-8  # for the mean error over the whole picture
    min_scale_px: float = 0.3  # ours: kernels here need a positive one


class Adan:
    """Adan (X. Xie et al., 2022): moments of the gradient, of its change, and of the square of both together."""

    def __init__(self, settings: AdanSettings, width: int, height: int, whole: tuple[int, int] = WHOLE) -> None:
        """Begin with moments of zero, for Gaussians in the middle width x height pixels of a whole picture."""
        self._settings, self._size, self._whole, self._steps = settings, (width, height), whole, 0
        self._eps = settings.eps * whole[0] * whole[1] / (width * height)
        self._moments: list[Tensor] = []

    def step(self, gaussians: Sequence[Tensor], gradient: Sequence[Tensor]) -> None:
        """Move means [..., N, 2], factors and colours [..., N, 3] in place."""
        means, factors, colors = gaussians
        middle, half = (torch.tensor(one).to(means) / 2 for one in (self._size, self._whole))
        place = ((means - middle) / half).clamp(-INSIDE, INSIDE)  # tanh of the parameter
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
        by = rate * (unbiased[0] + beta2 * unbiased[1]) / (unbiased[2].sqrt() + self._eps)
        means.copy_(half * torch.tanh(torch.atanh(place) - by[..., :2]) + middle)
        factors -= by[..., 2:5]
        factors[..., 0::2].clamp_(min=self._settings.min_scale_px)
        colors -= by[..., 5:]


def shaped(start: Gaussians, rng: np.random.Generator) -> Gaussians:
    """Give a start GaussianImage's shapes, up to a pixel and a half wide, and its colours, both random."""
    factors, colors = rng.random((len(start), 3)) + np.array([0.5, 0, 0.5]), rng.random((len(start), 3))
    return replace(start, factors=factors.astype(np.float32), colors=colors.astype(np.float32))


def fit(start: Gaussians, target: Tensor, settings: AdanSettings, steps: int, gradient_of: GradientOf) -> Gaussians:
    """Fit to a target [3, H, W] by Adan on the CPU."""
    gaussians, by = start.copy(), Gaussians.empty(len(start))
    (height, width), drawn = target.shape[1:], np.empty(target.shape, np.float32)
    values, gradient = ([torch.from_numpy(one) for one in of.arrays] for of in (gaussians, by))
    adan = Adan(settings, width, height)
    for _ in range(steps):
        raster = native.Rasterization(gaussians.means, gaussians.factors, width, height, CUTOFF_V1, pyramid=False)
        raster.render(gaussians.colors, drawn)
        by_picture = gradient_of(torch.from_numpy(drawn)[None], target[None])[0]
        raster.backward(gaussians.colors, by_picture.contiguous().numpy(), *by.arrays)
        adan.step(values, gradient)
    return gaussians
