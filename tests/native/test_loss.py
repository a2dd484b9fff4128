"""The native reconstruction loss MSE + lambda_g L_g against its definition in float64: the MSE, and the gradient."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from sgmethod.native import native
from tests.definitions.backend import geometry_loss

SIZES = [(1, 1), (7, 2), (2, 7), (1, 40), (3, 3), (4, 3), (50, 37), (33, 64), (18, 65)]  # width, height
LAMBDAS = [0.06, 1.0]
VALUE_TOLERANCE = 1e-7  # relative; worst seen 2.6e-8
GRADIENT_TOLERANCE = 3e-7  # of the gradient's largest value; worst seen 1.1e-7


def pictures(width: int, height: int) -> tuple[Tensor, Tensor]:
    """A target in [0, 1] and an image about it, float32 [3, H, W]."""
    generator = torch.Generator().manual_seed(width * 100 + height)
    target = torch.rand(3, height, width, generator=generator)
    return target, target + 0.3 * torch.randn(3, height, width, generator=generator)


@pytest.mark.parametrize("lambda_g", LAMBDAS)
@pytest.mark.parametrize("size", SIZES)
def test_values_and_gradient(size: tuple[int, int], lambda_g: float) -> None:
    target, image = pictures(*size)
    exact = image.double().requires_grad_()
    mse, geometry = (exact - target.double()).square().mean(), geometry_loss(exact, target.double())
    (expected,) = torch.autograd.grad(mse + lambda_g * geometry, exact)
    grad = torch.full_like(image, torch.nan)
    assert native.ReconstructionLoss(target, lambda_g)(image, grad) == pytest.approx(mse.item(), rel=VALUE_TOLERANCE)
    assert (grad - expected).abs().max() <= GRADIENT_TOLERANCE * expected.abs().max()
    assert native.ReconstructionLoss(target, lambda_g)(target, grad) == 0.0
    assert not grad.any()


def test_a_ramp_of_slope_one_has_gradient_eight() -> None:
    """Pins the scale of the definition's Sobel kernels, on which lambda_g depends."""
    ramp = torch.arange(5.0, dtype=torch.float64)
    target = ramp.expand(3, 4, 5)
    image = target + ramp / 2  # Gx = 8 and G'x - Gx = 4 in the 2 x 3 interior pixels of 4 x 5
    assert geometry_loss(image, target) == pytest.approx(6 / 20 * 8 * 16, rel=1e-6)  # worst error seen 0


def test_the_target_is_kept() -> None:
    """Not copied, which a large picture's memory would feel, but neither let go."""
    target, image = pictures(300, 300)
    before = native.ReconstructionLoss(target, 0.06)(image, torch.empty_like(image))
    loss = native.ReconstructionLoss(target.clone(), 0.06)
    overwrites_freed_memory = [torch.zeros_like(target) for _ in range(5)]
    assert loss(image, torch.empty_like(image)) == before
    assert len(overwrites_freed_memory) == 5


def test_other_shapes_and_types_are_refused() -> None:
    target, image = pictures(7, 5)
    loss = native.ReconstructionLoss(target, 0.06)
    with pytest.raises(TypeError):
        native.ReconstructionLoss(target[0], 0.06)
    for wrong in (torch.zeros(3, 7, 5), torch.zeros(3, 5, 8)):
        with pytest.raises(ValueError, match="another size"):
            loss(wrong, torch.empty_like(image))
        with pytest.raises(ValueError, match="another size"):
            loss(image, wrong)
    for wrong in (torch.zeros(1, 5, 7), torch.zeros(5, 7)):
        with pytest.raises(TypeError):
            loss(wrong, torch.empty_like(image))
    for grad in (torch.zeros(3, 5, 7).double(), torch.zeros(3, 5, 14)[:, :, ::2]):  # would be written to a copy
        with pytest.raises(TypeError):
            loss(image, grad)
