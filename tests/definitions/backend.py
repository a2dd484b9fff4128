"""The backend that defines the others, slow on purpose: in float64, with torch's derivatives and naive searches."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import conv2d

from sgmethod.backend.kernels import Kernels, Loss
from sgmethod.backend.planes import all_halved
from sgmethod.backend.protocol import (
    COARSE_SIDE,
    GRID_REACH,
    TARGET_WHITE,
    VISIBLE,
    Coding,
    Descent,
    Frame,
    Moments,
    RefineLimits,
    Target,
    Visibility,
)
from sgmethod.native import native
from sgmethod.scene import FloatArray, Gaussians
from tests.definitions.drawing import render, render_pyramid

MAX_SCALE, MAX_SLANT, MAX_AMPLITUDE = 8192.0, 2048.0, 32.0  # limits during a fit; a slant is |l2| / l3
FAINT = 0.03  # least amplitude in the limit on steps: without it, shapes of faint Gaussians would jump
SOBEL = torch.tensor([[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]], dtype=torch.float64)

# Half the second derivative of the squared error by the frame's d and S and by the colour, for an isolated Gaussian:
# to be multiplied by pi l1 l3, and for d and S by |colour|^2.
CURVATURE = np.array([1 / 2, 1 / 2, 3 / 4, 1 / 4, 3 / 4, 1, 1, 1])


def squared(errors: Tensor, visibility: Visibility | None) -> Tensor:
    """Weighted sum of squared errors [..., 3, H, W]."""
    return (errors * weighted(errors, visibility)).sum((-3, -2, -1))


def weighted(errors: Tensor, visibility: Visibility | None) -> Tensor:
    """Errors [..., 3, H, W] times their weights."""
    if visibility is None:
        return errors
    weights = torch.from_numpy(visibility.values.astype(np.float64) / VISIBLE)
    return torch.einsum("ab,...byx->...ayx", torch.from_numpy(visibility.color), errors) * weights


def with_coarse(errors: Tensor, frame: Frame, visibility: Visibility | None) -> Tensor:
    """Errors [3, H, W] plus the weighted mean over each one's square.

    What is beyond the picture, or hidden by alpha, has no error.
    """
    if visibility is None:
        return errors
    found, side = errors.clone(), max(COARSE_SIDE // frame.spacing, 1)
    shown = errors * torch.from_numpy(visibility.values > 0)
    for y in range(0, errors.shape[1], side):
        for x in range(0, errors.shape[2], side):
            square = np.s_[:, y : y + side, x : x + side]
            found[square] += visibility.coarse * shown[square].sum((1, 2), keepdim=True) / side**2
    return found


def geometry_loss(image: Tensor, target: Tensor) -> Tensor:
    """Loss L_g of images [3, H, W] (paper, section III-D).

    The mean of |Gx| (G'x - Gx)^2 + |Gy| (G'y - Gy)^2 over all pixels and channels; pixels without a whole 3 x 3
    neighbourhood add nothing.
    """
    if min(target.shape[1:]) < 3:
        return image.new_zeros(())
    kernels = torch.stack([SOBEL, SOBEL.T])[:, None]
    found, wanted = (conv2d(one[:, None], kernels) for one in (image, target))
    return (wanted.abs() * (found - wanted).square()).sum() / target.numel()


def bits(factors: Tensor, colors: Tensor, quantum: float) -> Tensor:
    """Smooth estimate [N] of each Gaussian's bits (Kernels.add_rate_gradient)."""
    l1, l2, l3 = factors.unbind(1)
    step = quantum / (native.COLOR_SCALE * (l1 * l3).sqrt())
    axes = colors @ torch.tensor(native.COLOR_BASIS, dtype=torch.float64).T / step[:, None]
    m = (axes.square().sum(1) + 1e-12).sqrt()
    v, r = torch.log(l1 / l3) / 2, l2 / l3
    values = torch.cat([axes, torch.stack([v * m, r * m / native.R_STEP, m, m, m], 1)], 1)
    return torch.log2(1 + values.abs()).sum(1)


def step_by_step(
    backend: Kernels | Reference, gaussians: Gaussians, moments: Moments, descent: Descent, rates: Sequence[float]
) -> list[float]:
    """Take steps by the other functions of a backend, so that a test can look at each; may be its method `steps`."""
    d, errors = descent, []
    for rate in rates:
        error, gradient = backend.gradients(gaussians, d.frame, d.target, d.visibility)
        if d.price > 0:
            backend.add_rate_gradient(gaussians, gradient, d.quantum, d.price)
        backend.step(gaussians, gradient, moments, d, rate)
        backend.keep_in_range(gaussians, d.width, d.height)
        errors.append(error)
    return errors


class Reference:
    """A Backend by these definitions, with derivatives by torch."""

    def residual(
        self, gaussians: Gaussians, frame: Frame, target: Target, first_row: int = 0, *, half: bool = False
    ) -> FloatArray:
        rows = _drawn(_tensors(gaussians), frame)[:, first_row : first_row + target.shape[1]]
        missing = _single(_image(target) - rows)
        return all_halved(missing) if half else missing

    def error(self, gaussians: Gaussians, frame: Frame, target: Target, visibility: Visibility | None = None) -> float:
        errors = _drawn(_tensors(gaussians), frame) - _image(target)
        return (errors * weighted(with_coarse(errors, frame, visibility), visibility)).sum().item() / target.size

    def gradients(
        self, gaussians: Gaussians, frame: Frame, target: Target, visibility: Visibility | None = None
    ) -> tuple[float, Gaussians]:
        leaves = _tensors(gaussians)
        errors = _drawn(leaves, frame) - _image(target)
        counted = weighted(with_coarse(errors, frame, visibility), visibility).detach() / target.size
        return (errors * counted).sum().item(), _gradient(2 * (errors * counted).sum(), leaves)

    def regularised(self, frame: Frame, image: FloatArray, lambda_g: float) -> Loss:
        """Build the loss of Kernels.regularised()."""
        target = torch.from_numpy(image.astype(np.float64))

        def evaluate(gaussians: Gaussians) -> tuple[float, Gaussians]:
            leaves = _tensors(gaussians)
            drawn = _drawn(leaves, frame)
            mse = (drawn - target).square().mean()
            return mse.item(), _gradient(mse + lambda_g * geometry_loss(drawn, target), leaves)

        return evaluate

    def gram(self, gaussians: Gaussians, frame: Frame, visibility: Visibility | None = None) -> FloatArray:
        """Differentiate half the picture's energy by each colour."""
        leaves = _tensors(gaussians)
        alike = None if visibility is None else Visibility(visibility.values, by_eye=False)
        return _gradient(squared(_drawn(leaves, frame), alike) / 2, leaves).colors

    def step(self, gaussians: Gaussians, gradient: Gaussians, moments: Moments, descent: Descent, rate: float) -> None:
        s = descent.settings
        means, factors, colors, gm, gf, gc = (a.astype(np.float64) for a in (*gaussians.arrays, *gradient.arrays))
        l1, l2, l3 = factors.T
        of_mean = l1 * gm[:, 0] + l2 * gm[:, 1], l3 * gm[:, 1]
        of_factor = l1 * gf[:, 0] + l2 * gf[:, 1], l3 * gf[:, 1], l3 * gf[:, 2]
        g = np.stack([*of_mean, *of_factor, *gc.T], 1)
        bias = moments.bias.astype(np.float64) * (s.beta1, s.beta2)
        first = s.beta1 * moments.first.astype(np.float64) + (1 - s.beta1) * g
        second = s.beta2 * moments.second.astype(np.float64) + (1 - s.beta2) * g * g
        rates = rate * np.array([s.mean_rate] * 2 + [s.factor_rate] * 3 + [s.color_rate] * 3)
        adam = rates / (np.sqrt(second / (1 - bias[:, 1:])) + 1e-15)
        weight = np.repeat(np.maximum(np.square(colors).sum(1, keepdims=True), FAINT**2), 8, axis=1)
        weight[:, 5:] = 1
        weight *= _seen_by(descent.visibility, descent.frame.spacing, gaussians)[:, None]
        newton = s.newton_steps * descent.values / (2 * math.pi * (l1 * l3)[:, None] * CURVATURE * weight)
        d1, d2, s1, s2, s3, *by_color = (-np.minimum(adam, newton) * first / (1 - bias[:, :1])).T
        gaussians.means[:] = means + np.stack([l1 * d1, l2 * d1 + l3 * d2], 1)
        l1, l2, l3 = l1 * np.exp(s1), l2 * np.exp(s1) + l3 * s2, l3 * np.exp(s3)
        gaussians.factors[:] = np.stack([np.maximum(l1, s.min_scale_px), l2, np.maximum(l3, s.min_scale_px)], 1)
        gaussians.colors[:] = colors + np.stack(by_color, 1)
        moments.first[:], moments.second[:], moments.bias[:] = first, second, bias

    def add_rate_gradient(self, gaussians: Gaussians, gradient: Gaussians, quantum: float, weight: float) -> None:
        _, factors, colors = _tensors(gaussians)
        total = weight * bits(factors, colors, quantum).sum()
        by_factors, by_colors = torch.autograd.grad(total, (factors, colors))
        gradient.factors[:] += by_factors.numpy()
        gradient.colors[:] += by_colors.numpy()

    def keep_in_range(self, gaussians: Gaussians, width: int, height: int) -> None:
        means, factors, colors = (values.astype(np.float64) for values in gaussians.arrays)
        l1, l3 = np.minimum(factors[:, ::2], MAX_SCALE).T
        slanted = np.clip(factors[:, 1], -MAX_SLANT * l3, MAX_SLANT * l3)
        margin = GRID_REACH * np.sqrt(l1 * l3)[:, None]
        gaussians.means[:] = np.clip(means, -margin, np.array([width, height]) + margin)
        gaussians.factors[:] = np.stack([l1, slanted, l3], 1)
        gaussians.colors[:] = np.clip(colors, -MAX_AMPLITUDE, MAX_AMPLITUDE)

    steps = step_by_step

    def rounded(self, gaussians: Gaussians, coding: Coding) -> Gaussians:
        """Encode and decode each Gaussian alone."""
        out = Gaussians(gaussians.means.copy(), gaussians.factors.copy(), np.zeros_like(gaussians.colors))
        for i in range(len(out)):
            payload = native.rd_encode(coding.parameters, *gaussians.rows(np.array([i])).arrays)
            if payload:
                for values, decoded in zip(out.arrays, native.rd_decode(coding.parameters, payload), strict=True):
                    values[i] = decoded[0]
        return out

    def refine(
        self, gaussians: Gaussians, coding: Coding, target: Target, limits: RefineLimits, visibility: Visibility | None
    ) -> bytes:
        """By the kernels: a search has no definition, and tests/native/test_refine.py states what it must reach."""
        return Kernels().refine(gaussians, coding, target, limits, visibility)


def _seen_by(visibility: Visibility | None, spacing: int, gaussians: Gaussians) -> NDArray[np.float64]:
    """Weights [N] of the errors that Gaussians cause."""
    if visibility is None:
        return np.ones(len(gaussians))
    x, y = np.floor(gaussians.means / spacing).astype(int).T
    height, width = visibility.values.shape
    here = np.maximum(visibility.values[y.clip(0, height - 1), x.clip(0, width - 1)] / VISIBLE, 1)
    share = 1 / np.sqrt(1 + COARSE_SIDE**2 / 12 / np.square(gaussians.factors[:, ::2], dtype=np.float64)).prod(1)
    return here * (1 + visibility.coarse * share)


def _tensors(gaussians: Gaussians) -> tuple[Tensor, ...]:
    return tuple(torch.from_numpy(values.astype(np.float64)).requires_grad_() for values in gaussians.arrays)


def _drawn(tensors: tuple[Tensor, ...], frame: Frame) -> Tensor:
    means, factors, colors = tensors
    draw = render_pyramid if frame.pyramid else render
    return draw(means / frame.spacing, factors / frame.spacing, colors, (frame.width, frame.height), frame.cutoff)


def _image(target: Target) -> Tensor:
    return torch.from_numpy(target.astype(np.float64) / TARGET_WHITE)


def _gradient(value: Tensor, leaves: tuple[Tensor, ...]) -> Gaussians:
    return Gaussians(*(_single(by) for by in torch.autograd.grad(value, leaves)))


def _single(values: Tensor) -> FloatArray:
    return values.detach().numpy().astype(np.float32)
