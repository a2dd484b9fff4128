"""The one differentiable render(): native kernels behind torch's autograd.

sgmethod.reference holds the definition; tests hold the two together, values and gradients.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from sgmethod.native import native


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, means: Tensor, factors: Tensor, colors: Tensor, size: tuple[int, int]) -> Tensor:
        width, height = size
        means, factors, colors = (t.detach().contiguous() for t in (means, factors, colors))
        ctx.raster = native.Rasterization(means.numpy(), factors.numpy(), width, height)
        ctx.save_for_backward(colors)
        image = torch.empty(3, height, width)
        ctx.raster.render(colors.numpy(), image.numpy())
        return image

    @staticmethod
    def backward(ctx: Any, *grads: Any) -> tuple[Tensor, Tensor, Tensor, None]:
        (colors,) = ctx.saved_tensors
        n = colors.shape[0]
        out = torch.empty(n, 2), torch.empty(n, 3), torch.empty(n, 3)
        ctx.raster.backward(colors.numpy(), grads[0].contiguous().numpy(), *(t.numpy() for t in out))
        return *out, None


def render(means: Tensor, factors: Tensor, colors: Tensor, size: tuple[int, int]) -> Tensor:
    """Image [3, height, width] of Gaussians, differentiable in means, factors and colors.

    Arguments as sgmethod.native.reference.render, in float32. A Gaussian whose l1 or l3 is not positive, or that is
    not finite, contributes nothing.
    """
    image: Tensor = _Render.apply(means, factors, colors, size)  # type: ignore[no-untyped-call]
    return image
