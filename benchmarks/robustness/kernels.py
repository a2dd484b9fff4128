"""Kernels on extreme Gaussians against the definition in float64.

Tests hold that instruction sets and numbers of threads draw the same bytes: the best one and all threads are measured.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from benchmarks.robustness.case import Case, Cases, Found
from sgmethod.backend.protocol import CUTOFF, MAX_CUTOFF, Frame
from sgmethod.bitstream.v2 import MAX_QUANTUM
from sgmethod.native import native
from sgmethod.scene import Gaussians
from tests.definitions import drawing

SIZE = (96, 64)
GAUSSIANS = 40  # Gaussians of a case
MANY_GAUSSIANS = 3000
VALUE_LIMIT, GRADIENT_LIMIT = 1e-5, 1e-3
HELD_UP_TO = 1e3  # the ratio of axes up to which gradients have a limit
NEAR = 0.3  # scales from the middle of a pixel, which a Gaussian smaller than a pixel may miss
MIN_MAGNITUDE = 1e-30  # no picture shows what is below; kernels may take denormal numbers for zero
VALUE_RULE = "error of a pixel, over the sum of the magnitudes of the colours there, 1e-30 at least"
GRADIENT_RULE = "error of a gradient against float64, over the largest of its kind, 1e-30 at least"


FRAMES = {"version 1": Frame(*SIZE, MAX_CUTOFF, pyramid=False), "version 2": Frame(*SIZE, CUTOFF)}


def cases() -> Cases:
    """Every set of Gaussians with every rule."""
    for name, (gaussians, limited) in extremes().items():
        for version, frame in FRAMES.items():
            case, limit = f"{name}, {version}", GRADIENT_LIMIT if limited else None
            yield Case(case, VALUE_RULE, VALUE_LIMIT, partial(values, gaussians, frame))
            yield Case(case, GRADIENT_RULE, limit, partial(gradients, gaussians, frame))


def extremes() -> dict[str, tuple[Gaussians, bool]]:
    """By name: Gaussians, and whether gradients have a limit there."""
    found: dict[str, tuple[Gaussians, bool]] = {}
    for power in range(-3, 5):
        found[f"scale 1e{power} pixels"] = scattered(scale=10.0**power), True
    for power in range(7):
        found[f"aspect ratio 1e{power}"] = scattered(scale=1.0, ratio=10.0**power), 10.0**power <= HELD_UP_TO
    for power in range(2, 7):
        found[f"centres 1e{power} pixels outside"] = outside(10.0**power), True
    one = scattered()
    point, shape = np.full((MANY_GAUSSIANS, 2), 32.25, np.float32), np.tile(one.factors[:1], (MANY_GAUSSIANS, 1))
    colors = np.random.default_rng(1).normal(0, 0.1, (MANY_GAUSSIANS, 3)).astype(np.float32)
    found[f"{MANY_GAUSSIANS:,} on one point"] = Gaussians(point, shape, colors), True
    means, factors = (np.concatenate([values, values]) for values in (one.means, one.factors))
    cancelled = np.concatenate([one.colors, np.float32(1e-6) - one.colors])
    found["colours that cancel to 1e-6"] = Gaussians(means, factors, cancelled), True
    found["denormal colours"] = Gaussians(one.means, one.factors, np.full_like(one.colors, 1e-40)), True
    slanted = one.factors.copy()
    slanted[:, 1] = 1e-40
    found["denormal slant"] = Gaussians(one.means, slanted, one.colors), True
    found["the largest values of a file"] = largest(), True
    return found


def scattered(scale: float = 2.0, ratio: float = 1.5) -> Gaussians:
    """GAUSSIANS over the picture at any angle; the minor axis is scale, the major one ratio times that. Half of those
    smaller than a pixel lie near the middle of one, where they are seen."""
    random = np.random.default_rng(0)
    means = random.uniform((0, 0), SIZE, (GAUSSIANS, 2))
    if scale < 1:
        means[::2] = np.floor(means[::2]) + 0.5 + scale * random.normal(0, NEAR, means[::2].shape)
    angle = random.uniform(0, math.pi, GAUSSIANS)
    minor = scale * np.exp(random.normal(0, 0.2, GAUSSIANS))
    major = ratio * minor
    cosine, sine = np.cos(angle), np.sin(angle)
    xx = (major * cosine) ** 2 + (minor * sine) ** 2
    l1 = np.sqrt(xx)
    l2 = (major**2 - minor**2) * sine * cosine / l1
    factors = np.stack([l1, l2, major * minor / l1], axis=1)
    colors = random.normal(0, 0.5, (GAUSSIANS, 3))
    return Gaussians(*(values.astype(np.float32) for values in (means, factors, colors)))


def outside(distance: float) -> Gaussians:
    """Centres so far away on every side, wide enough to reach the picture."""
    near = scattered(scale=distance)
    angle = np.linspace(0, 2 * math.pi, GAUSSIANS, endpoint=False)
    means = np.stack([48 + distance * np.cos(angle), 32 + distance * np.sin(angle)], axis=1)
    return Gaussians(means.astype(np.float32), near.factors, near.colors)


def largest() -> Gaussians:
    """Numbers that are too large, as the coarsest file of the largest picture stores them."""
    side, n = native.MAX_SIDE, 6
    parameters = native.RdParameters(side, side, MAX_QUANTUM)
    means = np.array([(0, 0), (side, 0), (0, side), (side, side), (48, 32), (1e9, -1e9)], np.float32)
    factors = np.array([(1e9, s * 1e9, 1e9) for s in (0, 1, -1, 1, -1, 0)], np.float32)
    colors = np.array([[s * 1e9] * 3 for s in (1, -1, 1, -1, 1, -1)], np.float32)
    out = np.empty((n, 2), np.float32), np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
    native.rd_quantise(parameters, means, factors, colors, *out)
    return Gaussians(*out)


def values(gaussians: Gaussians, frame: Frame) -> Found:
    """The worst error of a pixel."""
    image = np.empty((3, frame.height, frame.width), np.float32)
    raster(gaussians, frame).render(gaussians.colors, image)
    if not np.isfinite(image).all():
        return None, "values that are not finite"
    exact = defined(exact_tensors(gaussians), frame).detach().numpy()
    return float(np.max(np.abs(image - exact) / summed(gaussians, frame.cutoff))), ""


def gradients(gaussians: Gaussians, frame: Frame) -> Found:
    """The worst error of a gradient, each number of a Gaussian relative to its own kind."""
    tensors = exact_tensors(gaussians)
    exact = torch.autograd.grad(defined(tensors, frame), tensors, upstream())
    found, over = [np.empty_like(array) for array in gaussians.arrays], raster(gaussians, frame)
    over.render(gaussians.colors, np.empty((3, frame.height, frame.width), np.float32))
    over.backward(gaussians.colors, upstream().float().numpy(), *found)
    worst, where = 0.0, ""
    for name, true, by in zip(Gaussians.__annotations__, exact, found, strict=True):
        scale = np.maximum(np.abs(true.numpy()).max(axis=0), MIN_MAGNITUDE)
        errors = np.abs(by - true.numpy()).max(axis=0) / scale
        if not errors.max() <= worst:
            worst, where = float(errors.max()), f"{name}, column {int(errors.argmax())}"
    return worst, where


def raster(gaussians: Gaussians, frame: Frame) -> native.Rasterization:
    """Gaussians laid over a frame."""
    return native.Rasterization(gaussians.means, gaussians.factors, *SIZE, cutoff=frame.cutoff, pyramid=frame.pyramid)


def defined(tensors: list[Tensor], frame: Frame) -> Tensor:
    """The picture by its definition, float64."""
    draw = drawing.render_pyramid if frame.pyramid else drawing.render
    means, factors, colors = tensors
    return draw(means, factors, colors, SIZE, frame.cutoff)


def exact_tensors(gaussians: Gaussians) -> list[Tensor]:
    """Means, factors and colours in float64, with gradients."""
    return [torch.from_numpy(values.astype(np.float64)).requires_grad_() for values in gaussians.arrays]


def upstream() -> Tensor:
    """The gradient of the loss by the picture, [3, H, W]; rounded to float32 for the kernels."""
    return torch.from_numpy(np.random.default_rng(3).standard_normal((3, SIZE[1], SIZE[0]), np.float32)).double()


def summed(gaussians: Gaussians, cutoff: float) -> NDArray[np.float64]:
    """For each pixel the magnitudes of the colours of all Gaussians within whose rim, or a little outside, it lies; the
    largest colour where there is none."""
    x, y = (np.arange(side) + 0.5 for side in SIZE)
    total = np.zeros((3, SIZE[1], SIZE[0]))
    largest = max(float(np.abs(gaussians.colors).max()), MIN_MAGNITUDE)
    for mean, (l1, l2, l3), color in zip(*(values.astype(np.float64) for values in gaussians.arrays), strict=True):
        z1 = (x[None, :] - mean[0]) / l1
        z2 = (y[:, None] - mean[1] - l2 * z1) / l3
        total += np.abs(color)[:, None, None] * (z1 * z1 + z2 * z2 < 2 * cutoff + 1)
    return np.where(total > 0, np.maximum(total, MIN_MAGNITUDE), largest)
