"""The native steps of the fit against the same written down in torch: Adam in the Gaussian's frame, the price of bits,
the range that Gaussians are kept in."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from sgmethod.fitting.adam import FrameAdam
from sgmethod.fitting.parameters import Parameters
from sgmethod.native import native
from sgmethod.profiles import PAPER, RD, OptimiserSettings
from sgmethod.rd.quantiser import add_rate_gradient

COLOR_AXES = torch.tensor(
    [[3**-0.5] * 3, [2**-0.5, 0.0, -(2**-0.5)], [6**-0.5, -2 * 6**-0.5, 6**-0.5]], dtype=torch.float64
)


def gaussians(n: int, seed: int) -> Parameters:
    """Of sizes from 0.4 to 40 pixels and colours from nothing to 1."""
    g = torch.Generator().manual_seed(seed)
    scale = 0.4 * 100 ** torch.rand(n, 2, generator=g)
    shear = torch.randn(n, generator=g) * scale[:, 0]
    color = torch.randn(n, 3, generator=g) * torch.rand(n, 1, generator=g) ** 3
    return Parameters(torch.rand(n, 2, generator=g) * 500, torch.stack([scale[:, 0], shear, scale[:, 1]], 1), color)


def color_step(factors: Tensor, quantum: float) -> Tensor:
    return quantum / (1.5 * (factors[:, 0] * factors[:, 2]).sqrt())


def rate_bits(factors: Tensor, colors: Tensor, quantum: float) -> Tensor:
    """The estimate of which add_rate_gradient gives the gradient, in float64."""
    step = color_step(factors, quantum)
    axes = colors @ COLOR_AXES.T
    m = (axes.square().sum(1) / step**2 + 1e-12).sqrt()
    v, r = 0.5 * torch.log(factors[:, 0] / factors[:, 2]), factors[:, 1] / factors[:, 2]
    bits = torch.log2(1 + axes.abs() / step[:, None]).sum(1)
    return bits + torch.log2(1 + v.abs() * m) + torch.log2(1 + r.abs() * m / 2) + 3 * torch.log2(1 + m)


@pytest.mark.parametrize("quantum", [0.01, 0.15, 2.0])
def test_rate_gradient_is_that_of_the_estimate(quantum: float) -> None:
    p = gaussians(1500, 1)
    factors, colors = p.factors.double().requires_grad_(), p.colors.double().requires_grad_()
    expected = torch.autograd.grad(0.7 * rate_bits(factors, colors, quantum).sum(), [factors, colors])
    grad = Parameters(torch.zeros(1500, 2), torch.ones(1500, 3), torch.ones(1500, 3))
    add_rate_gradient(p, grad, quantum, 0.7)
    for found, wanted in zip((grad.factors, grad.colors), expected, strict=True):
        error = (found.double() - 1 - wanted).abs()
        size = wanted.abs().amax(1, keepdim=True) + 1
        assert (error <= 4e-5 * size).all()  # worst seen 1.3e-5: the axes cancel
    assert torch.equal(grad.means, torch.zeros(1500, 2))


def test_rate_gradient_is_finite_where_nothing_is_left() -> None:
    """A round Gaussian without colour: every term of the estimate has its kink there."""
    p = Parameters(torch.zeros(1, 2), torch.tensor([[2.0, 0.0, 2.0]]), torch.zeros(1, 3))
    grad = Parameters(torch.zeros(1, 2), torch.zeros(1, 3), torch.zeros(1, 3))
    add_rate_gradient(p, grad, 0.1, 1.0)
    assert torch.equal(grad.colors, torch.zeros(1, 3))
    assert grad.factors.isfinite().all()


def in_frame(factors: Tensor, by_means: Tensor, by_factors: Tensor, by_colors: Tensor) -> Tensor:
    """Gradients [N, 8] by d, S and the colour, where the mean moves by L d and the factor by L S."""
    (l1, l2, l3), (x, y), (a, b, c) = (t.unbind(1) for t in (factors, by_means, by_factors))
    return torch.cat([torch.stack([l1 * x + l2 * y, l3 * y, l1 * a + l2 * b, l3 * b, l3 * c], 1), by_colors], 1)


def moved(
    means: Tensor, factors: Tensor, colors: Tensor, move: Tensor, narrowest: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Gaussians moved by [N, 8] in their frames, none of them narrower than so many pixels."""
    l1, l2, l3 = factors.unbind(1)
    a, b = move[:, 2].exp(), move[:, 4].exp()
    means = means + torch.stack([l1 * move[:, 0], l2 * move[:, 0] + l3 * move[:, 1]], 1)
    l1, l3, l2 = (l1 * a).clamp_min(narrowest), (l3 * b).clamp_min(narrowest), l2 * a + l3 * move[:, 3]
    return means, torch.stack([l1, l2, l3], 1), colors + move[:, 5:]


CURVATURE = torch.tensor([0.5, 0.5, 0.75, 0.25, 0.75, 1, 1, 1]).double()  # over |colour|^2 but for the colour itself
FAINT = 0.03**2


def newton(factors: Tensor, colors: Tensor, gradient: Tensor, values: int) -> Tensor:
    """The step of Gauss-Newton for Gaussians that lie alone."""
    square = colors.square().sum(1, keepdim=True).clamp_min(FAINT).repeat(1, 8)
    square[:, 5:] = 1
    return -gradient * values / (2 * math.pi * factors[:, :1] * factors[:, 2:] * CURVATURE * square)


@pytest.mark.parametrize(("settings", "values"), [(PAPER, 1), (RD, 20)], ids=["adam", "no longer than Gauss-Newton"])
def test_adam_in_the_gaussians_frame(settings: OptimiserSettings, values: int) -> None:
    n, rate = 1200, 0.6
    p, adam = gaussians(n, 7), FrameAdam(n - 100, settings, values)
    first, second, age = torch.zeros(n, 8).double(), torch.zeros(n, 8).double(), torch.zeros(n, 1).double()
    s = settings
    rates = torch.tensor([s.mean_rate] * 2 + [s.factor_rate] * 3 + [s.color_rate] * 3).double()
    grad = gaussians(n, 8)
    old, young = torch.arange(n - 100), torch.arange(n - 100, n)
    early = Parameters(p.means[old].contiguous(), p.factors[old].contiguous(), p.colors[old].contiguous())
    early_grad = Parameters(grad.means[old], grad.factors[old], grad.colors[old])
    wanted = p.means.double(), p.factors.double(), p.colors.double()
    for step in range(6):  # the last hundred join after three steps
        rows = old if step < 3 else torch.cat([old, young])
        if step == 3:
            adam.extend(100)
            early = Parameters(
                torch.cat([early.means, p.means[young]]),
                torch.cat([early.factors, p.factors[young]]),
                torch.cat([early.colors, p.colors[young]]),
            )
            early_grad = grad
        adam.step(early, early_grad, rate)
        means, factors, colors = (t.clone() for t in wanted)
        g = in_frame(factors[rows], *(t[rows].double() for t in grad.tensors()))
        age[rows] += 1
        first[rows] = s.beta1 * first[rows] + (1 - s.beta1) * g
        second[rows] = s.beta2 * second[rows] + (1 - s.beta2) * g * g
        unbiased = first[rows] / (1 - s.beta1 ** age[rows])
        move = -rate * rates * unbiased / (second[rows] / (1 - s.beta2 ** age[rows])).sqrt()
        if settings is RD:
            most = RD.newton_steps * newton(factors[rows], colors[rows], unbiased, values)
            assert 0.1 < (most.abs() < move.abs()).double().mean() < 0.9  # both are met
            move = torch.where(most.abs() < move.abs(), most, move)
        here = means[rows], factors[rows], colors[rows]
        means[rows], factors[rows], colors[rows] = moved(*here, move, settings.min_scale_px)
        wanted = means, factors, colors
    for found, value in zip((early.means, early.factors, early.colors), wanted, strict=True):
        torch.testing.assert_close(found.double(), value, rtol=1e-4, atol=1e-4)


MAX_SCALE, MAX_SLANT, MAX_AMPLITUDE = 8192.0, 2048.0, 32.0


def kept_in_range(p: Parameters) -> Parameters:
    """What keep_in_range makes of p, which stays."""
    kept = p.rows(torch.arange(len(p.means)))
    native.keep_in_range(1.6, 500, 300, *(t.numpy() for t in kept.tensors()))
    return kept


def test_gaussians_are_kept_in_range() -> None:
    p, g = gaussians(1000, 3), torch.Generator().manual_seed(4)
    p.means[:500] = p.means[:500] * 4 - 750
    p.factors[::2] *= 10 ** (8 * torch.rand(500, 3, generator=g) - 3)
    p.colors[::3] *= 10 ** (4 * torch.rand(334, 1, generator=g))
    l1, l2, l3 = p.factors.double().unbind(1)
    l1, l3 = l1.clamp_max(MAX_SCALE), l3.clamp_max(MAX_SCALE)
    factors = torch.stack([l1, l2.clamp(-MAX_SLANT * l3, MAX_SLANT * l3), l3], 1)
    margin = 1.6 * (l1 * l3).sqrt()[:, None]
    means = torch.minimum(torch.maximum(p.means.double(), -margin), torch.tensor([[500.0, 300.0]]) + margin)
    wanted = (means, factors, p.colors.double().clamp(-MAX_AMPLITUDE, MAX_AMPLITUDE))
    found = kept_in_range(p)
    for before, after, value in zip(p.tensors(), found.tensors(), wanted, strict=True):
        assert 0.05 < (before != after).any(1).float().mean() < 0.7
        torch.testing.assert_close(after.double(), value, rtol=1e-6, atol=0)  # worst seen 1.2e-7
    again = kept_in_range(found)
    assert all(torch.equal(a, b) for a, b in zip(found.tensors(), again.tensors(), strict=True))


def test_what_is_in_range_stays() -> None:
    """Also at its ends."""
    p = Parameters(
        torch.tensor([[250.0, 150.0], [-4.0, 304.0]]),
        torch.tensor([[MAX_SCALE, -MAX_SLANT * MAX_SCALE, MAX_SCALE], [2.6, 0.0, 2.6]]),
        torch.tensor([[MAX_AMPLITUDE, -MAX_AMPLITUDE, 0.0], [0.1, 0.2, 0.3]]),
    )
    assert all(torch.equal(a, b) for a, b in zip(p.tensors(), kept_in_range(p).tensors(), strict=True))
