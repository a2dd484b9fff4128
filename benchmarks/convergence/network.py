"""SIREN, a network that shows a picture, moved by torch's Adam: what Gaussians are compared with."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from benchmarks.pictures import Pixels

# The best of 5e-4, 1e-3, 2e-3 and 8e-3, by the PSNR after 400 steps on astronaut at 128x128 with 2 bits per pixel.
RATE = 1e-3
BATCH = 1 << 14  # pixels of a step, and of what is drawn at a time
LAYERS, FREQUENCY = 4, 30  # hidden ones; of their sines


@dataclass(frozen=True)
class Network:
    """A network that shows a picture. colours: [K, 3] of places [K, 2] in [0, 1]; numbers: what is learned; rate, eps:
    of Adam; batch: pixels of a step."""

    colours: Callable[[Tensor], Tensor]
    numbers: list[nn.Parameter]
    rate: float = RATE
    eps: float = 1e-8
    batch: int = BATCH


def siren(numbers: int) -> Network:
    """Sitzmann et al.: sines of sines, with a limited number of parameters."""
    torch.manual_seed(0)
    width = max((w for w in range(2, 2000) if 3 * w + LAYERS * (w + 1) * w + 3 * (w + 1) <= numbers), default=2)
    sizes = [2, *[width] * (LAYERS + 1), 3]
    layers = [nn.Linear(a, b) for a, b in pairwise(sizes)]
    with torch.no_grad():
        for k, layer in enumerate(layers):
            reach = 1 / 2 if k == 0 else math.sqrt(6 / layer.in_features) / FREQUENCY
            layer.weight.uniform_(-reach, reach)

    def colours(at: Tensor) -> Tensor:
        x = at * 2 - 1
        for layer in layers[:-1]:
            x = torch.sin(FREQUENCY * layer(x))
        return layers[-1](x) / 2 + 0.5  # type: ignore[no-any-return]

    return Network(colours, [number for layer in layers for number in layer.parameters()])


class Training:
    """Adam on the squared error of random pixels."""

    def __init__(self, network: Network, pixels: Pixels) -> None:
        self.network, self.shape = network, pixels.shape
        self._colours = torch.tensor(pixels.reshape(-1, 3))
        self._optimiser = torch.optim.Adam(network.numbers, lr=network.rate, eps=network.eps)
        self._random = torch.Generator().manual_seed(0)

    def step(self) -> None:
        """Take one step."""
        index = torch.randint(len(self._colours), (self.network.batch,), generator=self._random)
        self._optimiser.zero_grad()
        loss = ((self.network.colours(_places(index, self.shape)) - self._colours[index] / 255) ** 2).mean()
        loss.backward()  # type: ignore[no-untyped-call]
        self._optimiser.step()


@torch.no_grad()
def drawn(network: Network, shape: tuple[int, ...], apart: int = 1) -> Pixels:
    """The picture [H, W, 3] that it shows now. apart: draw only every apart-th row and column."""
    some = torch.arange(shape[0] * shape[1]).reshape(shape[:2])[::apart, ::apart]
    every = some.reshape(-1)
    parts = [network.colours(_places(every[k : k + BATCH], shape)) for k in range(0, len(every), BATCH)]
    return levels_of(torch.cat(parts).numpy().reshape(*some.shape, 3))


def _places(index: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Places of pixels by their numbers, x and y in [0, 1]."""
    height, width = shape[:2]
    return torch.stack([(index % width + 0.5) / width, (index // width + 0.5) / height], 1)


def levels_of(values: NDArray[Any]) -> Pixels:
    """8-bit pixels of values in [0, 1]."""
    return np.asarray(np.round(np.clip(values, 0, 1) * 255), np.uint8)
