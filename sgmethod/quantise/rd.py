"""The quantiser of profile rd as the fit sees it: steps from sensitivity, noise, rate.

The integers and the exact rounding live in native code (sgmethod/native/rd_codec.cpp), where also the derivation of
the steps stands. All of them follow from the size s = sqrt(l1 l3), the quantum q and m, the length of the colour in
its steps of q / (s sqrt(pi)):

    u = log s: 0.707 / m    v = log(l1 / l3) / 2: 1 / m    r = l2 / l3: 2 / m    mean in units of L: 1.414 / m

Every parameter then costs the picture the same: q^2 / 12 of squared error on average.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from sgmethod.bitstream_rd import RdStream, quantum_code, quantum_of
from sgmethod.fit import Parameters
from sgmethod.native_module import native

U_STEP, V_STEP, R_STEP, MEAN_STEP = math.sqrt(0.5), 1.0, 2.0, math.sqrt(2.0)
CLASS_WIDTH = math.log(2) / 2  # u is coded within classes of this width
# Rows: luma-like and two chroma-like axes, orthonormal, so that equal steps are equal errors in RGB.
COLOR_BASIS = torch.tensor(
    [[3**-0.5] * 3, [2**-0.5, 0.0, -(2**-0.5)], [6**-0.5, -2 * 6**-0.5, 6**-0.5]], dtype=torch.float32
)


def error_per_bit(quantum: float) -> float:
    """What one bit buys at the margin, in squared error summed over the picture: of a uniform quantiser's error
    q^2 / 12 a further bit takes away 3/4, that is -d(q^2 / 12)/d(bits) = q^2 ln(2) / 6."""
    return quantum**2 * math.log(2) / 6


def _color_step(factors: Tensor, quantum: float) -> Tensor:
    return quantum / (math.sqrt(math.pi) * (factors[:, 0] * factors[:, 2]).sqrt())


def dithered(p: Parameters, quantum: float, generator: torch.Generator) -> Parameters:
    """p with uniform noise as wide as the quantiser's steps: what rounding does, but with useful gradients."""
    step = _color_step(p.factors, quantum)
    m = (p.colors.square().sum(1).sqrt() / step).clamp_min(1.0)
    noise = torch.rand(len(m), 8, generator=generator) - 0.5
    l1, l2, l3 = p.factors.unbind(1)
    dx, dy = (noise[:, :2] * (MEAN_STEP / m)[:, None]).unbind(1)
    u = noise[:, 2] * (U_STEP / m).clamp_max(CLASS_WIDTH)
    v = noise[:, 3] * V_STEP / m
    r = l2 / l3 + noise[:, 4] * R_STEP / m
    n1, n3 = l1 * torch.exp(u + v), l3 * torch.exp(u - v)
    means = p.means + torch.stack([l1 * dx, l2 * dx + l3 * dy], 1)
    return Parameters(means, torch.stack([n1, r * n3, n3], 1), p.colors + noise[:, 5:] * step[:, None])


def rate_bits(factors: Tensor, colors: Tensor, quantum: float) -> Tensor:
    """A smooth estimate of each Gaussian's bits [N], up to a constant: log2(1 + |value| / step) of every coded
    value, and log2(1 + m) for u and both coordinates, whose range does not depend on their value."""
    step = _color_step(factors, quantum)
    color = colors @ COLOR_BASIS.T
    m = (color.square().sum(1) + 1e-12).sqrt() / step
    v = 0.5 * torch.log(factors[:, 0] / factors[:, 2])
    r = factors[:, 1] / factors[:, 2]
    color_bits = torch.log2(1 + color.abs() / step[:, None]).sum(1)
    shape_bits = torch.log2(1 + v.abs() * m / V_STEP) + torch.log2(1 + r.abs() * m / R_STEP)
    return color_bits + shape_bits + 3 * torch.log2(1 + m)


def add_rate_gradient(p: Parameters, grad: Parameters, quantum: float, weight: float) -> None:
    """Add the gradient of weight * sum of rate_bits."""
    factors, colors = p.factors.detach().requires_grad_(), p.colors.detach().requires_grad_()
    bits = rate_bits(factors, colors, quantum).sum() * weight
    by_factors, by_colors = torch.autograd.grad(bits, [factors, colors])
    grad.factors += by_factors
    grad.colors += by_colors


def energies(p: Parameters) -> Tensor:
    """Squared error [N] that each Gaussian alone would leave if it were dropped."""
    return math.pi * p.factors[:, 0] * p.factors[:, 2] * p.colors.square().sum(1)


class Coder:
    """Exact rounding and exact sizes for one picture and quantum."""

    def __init__(self, size: tuple[int, int], quantum: float, background: tuple[int, int, int], grey: bool) -> None:
        self.size, self.background, self.grey = size, background, grey
        self.quantum = quantum_of(quantum_code(quantum))
        self._parameters = native.RdParameters(*size, self.quantum, grey)

    def with_quantum(self, quantum: float) -> Coder:
        """The same with another quantum."""
        return Coder(self.size, quantum, self.background, self.grey)

    def rounded(self, p: Parameters) -> Parameters:
        """What the decoder will see; colour 0 where nothing of a Gaussian is left."""
        out = Parameters(torch.empty_like(p.means), torch.empty_like(p.factors), torch.empty_like(p.colors))
        means, factors, colors = (t.contiguous() for t in (p.means, p.factors, p.colors))
        native.rd_quantise(self._parameters, means, factors, colors, out.means, out.factors, out.colors)
        return out

    def stream(self, p: Parameters) -> RdStream:
        """The coded picture."""
        return RdStream.of(p.numpy(), self.size, self.quantum, self.background, self.grey)
