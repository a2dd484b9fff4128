"""GaussianImage's parameters, drawn as its kernel draws them."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from sgmethod import GaussiansError
from sgmethod.torch import from_gaussian_image, render

SIZE = 23, 17


def parameters() -> tuple[Tensor, Tensor, Tensor]:
    """Twenty Gaussians, of which some have negative l1 or l3."""
    generator = torch.Generator().manual_seed(5)
    xyz, cholesky, features = (torch.randn(20, last, generator=generator) for last in (2, 3, 3))
    return xyz, torch.where(cholesky.abs() < 1, 1.5 * cholesky.sign(), 2 * cholesky), features


def drawn(xyz: Tensor, cholesky: Tensor, features: Tensor) -> Tensor:
    """The sum of GaussianImage's kernel: pixels at whole numbers, conics, and a cut-off where the weight is 1/255."""
    width, height = SIZE
    center = 0.5 * torch.tensor(SIZE) * torch.tanh(xyz) + 0.5 * torch.tensor(SIZE)
    l1, l2, l3 = (cholesky + torch.tensor([0.5, 0, 0.5])).unbind(1)
    a, b, c = l1 * l1, l1 * l2, l2 * l2 + l3 * l3
    det = a * c - b * b
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    dx, dy = x - center[:, 0, None, None], y - center[:, 1, None, None]
    conic = (one[:, None, None] for one in (c / det, -b / det, a / det))
    xx, xy, yy = conic
    weight = torch.exp(-0.5 * (xx * dx * dx + yy * dy * dy) - xy * dx * dy)
    return torch.einsum("nc,nyx->cyx", features, torch.where(weight < 1 / 255, 0, weight))


def test_the_picture_is_that_of_its_kernel() -> None:
    given = parameters()
    assert (given[1][:, 0] < -0.5).any()
    assert (given[1][:, 2] < -0.5).any()
    here = render(*from_gaussian_image(*given, SIZE), SIZE, pyramid=False)
    there = drawn(*given)
    # Here a weight falls to zero at exp(-3), and there it ends in a step at 1/255.
    assert (here - there).square().mean() < 0.005 * there.square().mean()  # 0.0024 seen; 0.016 with the same factors
    assert here.sum().item() == pytest.approx(there.sum().item(), rel=0.02)


def test_other_shapes_are_refused() -> None:
    xyz, cholesky, features = parameters()
    with pytest.raises(GaussiansError, match=r"\[N, 2\], \[N, 3\] and \[N, 3\], got \[20, 2\], \[19, 3\], \[20, 3\]"):
        from_gaussian_image(xyz, cholesky[1:], features, SIZE)
    with pytest.raises(GaussiansError, match="must be tensors, not ndarray"):
        from_gaussian_image(xyz.numpy(), cholesky, features, SIZE)
