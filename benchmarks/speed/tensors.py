"""The differentiable renderer, forward and backward, beside plain torch, in turns.

    python -m benchmarks.speed tensors --image FILE [--gaussians 10000] [--steps 300] [--rounds 7] [--device cuda]

Gaussians are those of a short fit to the picture, at 768 x 512. Each row is the median time of the gradient of the mean
squared error against it, by all means, factors and colours:

kernels    sgmethod.torch.render() in single precision on the CPU; with and without the pyramid
pairs      the same by operations on tensors, as on other devices; on --device if one is given
reference  GaussianImage's accumulated blending as plain torch does it, with its derivatives by autograd: tiles of
           16 x 16 pixels in a loop, in each the Gaussians whose three standard deviations reach into it. A loop over
           pixels, as gsplat's first reference has, takes longer still.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks.machine import RUNS, Record
from benchmarks.speed.kernels import SIZE, fitted, load
from sgmethod.backend.pairs import Pairs
from sgmethod.native import native
from sgmethod.torch import render

TILE = 16
LEAST = 1 / 255  # of exp(-sigma)


def reference(means: Tensor, factors: Tensor, colors: Tensor) -> Tensor:
    """[3, height, width]."""
    l1, l2, l3 = factors.unbind(1)
    a, b, c = l1 * l1, l1 * l2, l2 * l2 + l3 * l3
    determinant = a * c - b * b
    conics = torch.stack([c / determinant, -b / determinant, a / determinant], 1)
    middle = (a + c) / 2
    radii = (3 * (middle + (middle * middle - determinant).clamp_min(0.1).sqrt()).sqrt()).ceil().detach()
    width, height = SIZE
    image = []
    x_in, y_in = (values.reshape(-1) + 0.5 for values in torch.meshgrid(*[torch.arange(TILE)] * 2, indexing="xy"))
    for top in range(0, height, TILE):
        row = []
        in_row = (means[:, 1] + radii > top) & (means[:, 1] - radii < top + TILE)
        for left in range(0, width, TILE):
            index = (in_row & (means[:, 0] + radii > left) & (means[:, 0] - radii < left + TILE)).nonzero()[:, 0]
            mean, conic = means[index], conics[index]
            dx, dy = x_in + left - mean[:, :1], y_in + top - mean[:, 1:]
            sigma = (conic[:, :1] * dx * dx + conic[:, 2:] * dy * dy) / 2 + conic[:, 1:2] * dx * dy
            weights = torch.exp(-sigma)
            weights = torch.where(weights >= LEAST, weights, 0)
            row.append((colors[index].T @ weights).reshape(3, TILE, TILE))
        image.append(torch.cat(row, 2))
    return torch.cat(image, 1)


def pairs(means: Tensor, factors: Tensor, colors: Tensor, target: Tensor) -> tuple[Tensor, ...]:
    """The gradient by lists of pairs on the tensors' device, also where render() would take the kernels."""
    laid = Pairs(means, factors, SIZE, native.CUTOFF_V2, pyramid=True)
    by_image = 2 * (laid.draw(colors) - target) / target.numel()
    return laid.gradients(colors, by_image)


def by_autograd(draw: Callable[..., Tensor], values: list[Tensor], target: Tensor) -> tuple[Tensor, ...]:
    """The gradient of the mean squared error."""
    return torch.autograd.grad((draw(*values) - target).square().mean(), values)


def configurations(values: list[Tensor], target: Tensor, device: str) -> dict[str, Callable[[], tuple[Tensor, ...]]]:
    """What takes turns, by its name."""
    leaves = [one.clone().requires_grad_() for one in values]
    target_there = target.to(device)
    means, factors, colors = (one.to(device) for one in values)

    def drawn(*some: Tensor, pyramid: bool = True) -> Tensor:
        return render(some[0], some[1], some[2], SIZE, pyramid=pyramid)

    return {
        "kernels": lambda: by_autograd(drawn, leaves, target),
        "kernels, no pyramid": lambda: by_autograd(partial(drawn, pyramid=False), leaves, target),
        f"pairs, {device}": lambda: pairs(means, factors, colors, target_there),
        "reference": lambda: by_autograd(reference, leaves, target),
    }


def seconds(compute: Callable[[], tuple[Tensor, ...]]) -> float:
    """One evaluation, to its end on the device."""
    began = time.perf_counter()
    _ = [values.sum().item() for values in compute()]
    return time.perf_counter() - began


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--image", type=Path, required=True)
    parser.add_argument("--gaussians", type=int, default=10_000)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--out", type=Path, default=RUNS / "tensors.json")
    args = parser.parse_args()
    torch.set_num_threads(native.thread_count())
    pixels = load(args.image)
    gaussians, _ = fitted(pixels, args.gaussians, args.steps)
    values = [torch.from_numpy(array) for array in gaussians.arrays]
    target = torch.from_numpy(np.ascontiguousarray(pixels.transpose(2, 0, 1), np.float32) / 255)
    measured = configurations(values, target, args.device)
    times: dict[str, list[float]] = {name: [] for name in measured}
    for _ in range(args.rounds):
        for name, compute in measured.items():
            times[name].append(seconds(compute))
    record = Record(
        args.out, "benchmarks.speed tensors", {"gaussians": args.gaussians, "size": SIZE, "steps": args.steps}
    )
    for name, some in times.items():
        record.add({"name": name, "gradient_ms": 1e3 * statistics.median(some[1:])})  # the first one warms up
