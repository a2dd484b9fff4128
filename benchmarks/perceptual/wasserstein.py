"""Wasserstein Distortion: are the features of two pictures alike in local mean and local spread? Grain in other places
costs nothing, grain of other strength does.

Qiu et al., "Wasserstein Distortion: Unifying Fidelity and Realism", 2024. As Cool-Chic 5 takes it: relu1_2, relu2_2,
relu3_3 and relu4_3 of VGG16, each with a sigma of 8 of its own pixels. The network sees colours as it was trained to.
VGG16 is torchvision's (IMAGENET1K_V1), which LPIPS leaves as it is; benchmarks.perceptual.weights fetches it.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from benchmarks.pictures import Pixels

LAYERS = 10  # convolutions up to relu4_3
POOLED = (2, 4, 7)  # after this number of convolutions a feature is taken, and the rest sees half the size
LOG2_SIGMA = 3
MEAN, SPREAD = ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225])  # of ImageNet


class Wasserstein:
    """The measure. What the network sees in a source is kept until another one comes."""

    def __init__(self, weights: Path) -> None:
        """weights: the folder, as networks.py has it."""
        with np.load(weights / "lpips_vgg16.npz") as arrays:
            names = [f"VGG16_0.Conv_{i}" for i in range(LAYERS)]
            self._layers = [[torch.from_numpy(arrays[f"{name}.{of}"]) for of in ("kernel", "bias")] for name in names]
        self._source: Pixels | None = None
        self._seen: list[tuple[Tensor, Tensor]] = []

    @torch.no_grad()
    def __call__(self, picture: Pixels, source: Pixels) -> float:
        """The distance of a picture [H, W, 3], with sides of 64 pixels or more; 0 for the source itself."""
        if self._source is not source:
            self._source, self._seen = source, self._statistics(source)
        return sum(distance(*pair) for pair in zip(self._statistics(picture), self._seen, strict=True))

    def _statistics(self, pixels: Pixels) -> list[tuple[Tensor, Tensor]]:
        return [statistics(feature, LOG2_SIGMA) for feature in self._features(pixels)]

    def _features(self, pixels: Pixels) -> Iterator[Tensor]:
        mean, spread = (torch.tensor(values).view(3, 1, 1) for values in (MEAN, SPREAD))
        x = (torch.from_numpy(pixels.astype(np.float32) / 255).permute(2, 0, 1) - mean) / spread
        for i, (kernel, bias) in enumerate(self._layers, 1):
            x = functional.relu(functional.conv2d(x, kernel, bias, padding=1))
            if i in (*POOLED, LAYERS):
                yield x
                x = functional.max_pool2d(x, 2)


def statistics(feature: Tensor, log2_sigma: int) -> tuple[Tensor, Tensor]:
    """Local means and standard deviations of a feature [C, H, W], at every 2^(log2_sigma - 1)th place. The window is
    [1 2 1] / 4 both ways, log2_sigma times, with a halving between; with 0 each place stands alone."""
    mean, square = feature, feature.square()
    for level in range(1, log2_sigma + 1):
        mean, square = (_low_passed(x, 1 if level == log2_sigma else 2) for x in (mean, square))
    return mean, (square - mean.square()).clamp(min=0).sqrt()


def distance(one: tuple[Tensor, Tensor], other: tuple[Tensor, Tensor]) -> float:
    """The squared distance of Gaussians with these means and deviations, on average over places and channels."""
    return sum(float((a - b).square().mean()) for a, b in zip(one, other, strict=True))


def _low_passed(x: Tensor, step: int) -> Tensor:
    """Blur by [1 2 1] / 4 and take every step-th place, both ways. Beyond an edge a feature is reflected."""
    for axis in (1, 2):
        around = [(0, 0, 1, 1), (1, 1, 0, 0)][axis - 1]
        padded = functional.pad(x, around, mode="reflect")
        count = x.shape[axis]
        low, middle, high = (padded.narrow(axis, k, count).transpose(1, axis)[:, ::step] for k in range(3))
        x = ((low + high) / 4 + middle / 2).transpose(1, axis)
    return x
