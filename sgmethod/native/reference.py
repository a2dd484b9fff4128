"""The renderer's definition, slow on purpose: every pixel sees every Gaussian, in float64.

    image(p) = sum_i c_i w(sigma_i(p)),   w(sigma) = max(exp(-sigma) - exp(-cutoff), 0)
    sigma = (z1^2 + z2^2) / 2,            z = L^-1 (p - mean)

which is the paper's accumulated blending (section III-A) with the cut-off of docs/format.md: the ellipse
sigma <= cutoff carries a Gaussian, and the subtracted constant lets it end in zero instead of a step.
Pixel (row, column) has its centre at (column + 0.5, row + 0.5).
"""

from __future__ import annotations

import math

import torch
from torch import Tensor


def render(means: Tensor, factors: Tensor, colors: Tensor, size: tuple[int, int], cutoff: float) -> Tensor:
    """Image [3, height, width] of Gaussians, differentiable by torch in every argument.

    means [N, 2] in pixels (x, y); factors [N, 3] = (l1, l2, l3) of the lower triangular L in pixels,
    covariance = L L^T; colors [N, 3]; size (width, height) in pixels; cutoff as the version of the format has it.
    """
    width, height = size
    x = torch.arange(width, dtype=means.dtype) + 0.5
    y = torch.arange(height, dtype=means.dtype) + 0.5
    image = torch.zeros(3, height, width, dtype=means.dtype)
    for mean, (l1, l2, l3), color in zip(means, factors, colors, strict=True):
        z1 = (x[None, :] - mean[0]) / l1
        z2 = (y[:, None] - mean[1] - l2 * z1) / l3
        sigma = (z1 * z1 + z2 * z2) / 2
        weight = (torch.exp(-sigma) - math.exp(-cutoff)).clamp_min(0)
        image = image + color[:, None, None] * weight
    return image
