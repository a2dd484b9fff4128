"""The definition of the renderer, slow on purpose: every pixel sums every Gaussian, in float64.

    image(p) = sum_i c_i w(sigma_i(p)),   w(sigma) = max(exp(-sigma) - exp(-cutoff), 0)
    sigma = (z1^2 + z2^2) / 2,            z = L^-1 (p - mean)

This is the paper's accumulated blending (section III-A) with the cut-off of docs/format.md: a Gaussian is limited to
the ellipse sigma <= cutoff, and the subtracted constant makes it end at zero instead of in a step. Pixel (row, column)
has its centre at (column + 0.5, row + 0.5).

render_pyramid() defines version 2, where wide Gaussians are drawn on coarser levels.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor


def render(means: Tensor, factors: Tensor, colors: Tensor, size: tuple[int, int], cutoff: float) -> Tensor:
    """Draw Gaussians to an image [3, height, width], differentiable by torch in every tensor.

    means [N, 2] in pixels (x, y); factors [N, 3] = (l1, l2, l3) of the lower triangular L in pixels,
    covariance = L L^T; colors [N, 3]; size (width, height) in pixels; cutoff: of the file format's version.
    """
    width, height = size
    return _sum(means, factors, colors, (range(width), range(height)), cutoff)


def _sum(means: Tensor, factors: Tensor, colors: Tensor, samples: tuple[range, range], cutoff: float) -> Tensor:
    """Sum of Gaussians at samples (columns, rows); sample i has its centre at i + 0.5."""
    x, y = (torch.tensor(list(places), dtype=means.dtype) + 0.5 for places in samples)
    (x0, y0), (l1, l2, l3) = means.T[..., None, None], factors.T[..., None, None]
    z1 = (x - x0) / l1
    z2 = (y[:, None] - y0 - l2 * z1) / l3
    sigma = (z1 * z1 + z2 * z2) / 2
    weights = (torch.exp(-sigma) - math.exp(-cutoff)).clamp_min(0)
    return torch.einsum("nc,nyx->cyx", colors, weights)


MAX_LEVEL = 12
NARROWEST = 1.4  # samples


def render_pyramid(means: Tensor, factors: Tensor, colors: Tensor, size: tuple[int, int], cutoff: float) -> Tensor:
    """Draw like render(), with each Gaussian on its level of the pyramid."""
    levels = torch.tensor([level_of(*factor) for factor in factors.tolist()], dtype=torch.int64)
    image: Tensor | None = None
    for level in range(max(levels.tolist(), default=0), -1, -1):
        border = 1 if level else 0
        columns, rows = (range(-border, -(-side // 2**level) + border) for side in size)
        if image is not None:
            image = _enlarged(_enlarged(image, columns).mT, rows).mT
        here = levels == level
        drawn = _sum(*_levelled(means[here], factors[here], colors[here], level), (columns, rows), cutoff)
        image = drawn if image is None else image + drawn
    assert image is not None
    return image


def level_of(l1: float, l2: float, l3: float) -> int:
    """Highest level on which the minor axis is at least NARROWEST samples long."""
    a, c = l1 * l1, l2 * l2 + l3 * l3
    minor = 2 * a * l3 * l3 / (a + c + math.sqrt((a - c) ** 2 + 4 * a * l2 * l2))
    level = 0
    while level < MAX_LEVEL and minor / NARROWEST**2 >= 4.0 ** (level + 1):
        level += 1
    return level


def _levelled(means: Tensor, factors: Tensor, colors: Tensor, level: int) -> tuple[Tensor, Tensor, Tensor]:
    """Convert Gaussians to samples of a level, narrowed by the blur that enlarging adds."""
    variance = (1 - 4.0**-level) / 4
    l1, l2, l3 = (factors / 2**level).unbind(1)
    a, b, c = l1**2 - variance, l1 * l2, l2**2 + l3**2 - variance
    n1 = a.sqrt()
    n2, n3 = b / n1, (a * c - b * b).sqrt() / n1
    return means / 2**level, torch.stack([n1, n2, n3], 1), colors * (l1 * l3 / (n1 * n3))[:, None]


def _enlarged(image: Tensor, places: range) -> Tensor:
    """Interpolate samples [..., places] from coarse ones, which begin at place -1.

    An even place lies between its own coarse sample and the one before, an odd place between its own and the next.
    """
    near = torch.tensor([place // 2 for place in places])
    far = torch.tensor([place // 2 + (1 if place % 2 else -1) for place in places])
    return 0.75 * image[..., near + 1] + 0.25 * image[..., far + 1]
