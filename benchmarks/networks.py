"""Networks that show a picture, to compare Gaussians with: SIREN, WIRE and a hash grid.

Each is as large as a count of real numbers allows. torch's Adam moves it, without kernels of its own.
"""

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

# Each the best of those tried, by the PSNR after 400 steps on astronaut at 128x128 with networks of 2 bits per pixel:
# 5e-4, 1e-3, 2e-3, 8e-3 and 3e-3, 1e-2, 3e-2.
RATE_OF_SIREN, RATE_OF_GRID = 1e-3, 3e-2
# Its authors'. On that picture, after 150 steps, other frequencies and widths (10, 20) are up to 4 dB worse, and a rate
# of 1e-2 is 0.2 dB better: networks are larger where it is measured.
RATE_OF_WIRE = 5e-3
BATCH = 1 << 14  # pixels of a step
SIREN_LAYERS = 4  # hidden ones
SIREN_FREQUENCY = 30
WIRE_LAYERS = 2  # hidden ones after the first, as its authors take for pictures
WIRE_FREQUENCY, WIRE_WIDTH = 5, 5  # of a wavelet: omega, s
LEVELS, FEATURES, WIDTH = 8, 2, 16  # of the hash grid: levels, numbers of an entry, neurons of a layer
COARSEST, FINEST = 8, 4  # cells along the first level's side, pixels of a cell of the last


@dataclass(frozen=True)
class Network:
    """colours: [K, 3] of places [K, 2] in [0, 1]; numbers: what is learned; rate: of Adam."""

    colours: Callable[[Tensor], Tensor]
    numbers: list[nn.Parameter]
    rate: float

    def size(self) -> int:
        """Real numbers; a complex one is two."""
        return sum(number.numel() * (2 if number.is_complex() else 1) for number in self.numbers)


def siren(pixels: Pixels | None, numbers: int, hidden: int = SIREN_LAYERS) -> Network:
    """Sitzmann et al.: sines of sines. hidden: layers between the first and the last."""
    del pixels  # every picture has the same network
    torch.manual_seed(0)
    width = _widest(numbers, lambda w: 3 * w + hidden * (w + 1) * w + 3 * (w + 1))
    sizes = [2, *[width] * (hidden + 1), 3]
    layers = [nn.Linear(a, b) for a, b in pairwise(sizes)]
    with torch.no_grad():
        for k, layer in enumerate(layers):
            reach = 1 / 2 if k == 0 else math.sqrt(6 / layer.in_features) / SIREN_FREQUENCY
            layer.weight.uniform_(-reach, reach)

    def colours(at: Tensor) -> Tensor:
        x = at * 2 - 1
        for layer in layers[:-1]:
            x = torch.sin(SIREN_FREQUENCY * layer(x))
        return layers[-1](x) / 2 + 0.5  # type: ignore[no-any-return]

    return Network(colours, [number for layer in layers for number in layer.parameters()], RATE_OF_SIREN)


def wire(pixels: Pixels, numbers: int) -> Network:
    """Saragadam et al.: complex Gabor wavelets, exp(i omega x - |s x|^2); the picture is the real part."""
    del pixels
    torch.manual_seed(0)
    width = _widest(numbers, lambda w: 3 * w + 2 * (WIRE_LAYERS * (w + 1) * w + 3 * (w + 1)))
    layers = [nn.Linear(2, width)]
    layers += [nn.Linear(a, b, dtype=torch.cfloat) for a, b in pairwise([*[width] * (WIRE_LAYERS + 1), 3])]

    def colours(at: Tensor) -> Tensor:
        x = at * 2 - 1
        for layer in layers[:-1]:
            x = layer(x)
            # |x|^2 by its parts: the gradient of abs() takes roots that nobody needs
            square = x.real.square() + x.imag.square() if x.is_complex() else x.square()
            x = torch.exp(1j * WIRE_FREQUENCY * x - WIRE_WIDTH**2 * square)
        return layers[-1](x).real / 2 + 0.5  # type: ignore[no-any-return]

    return Network(colours, [number for layer in layers for number in layer.parameters()], RATE_OF_WIRE)


def hash_grid(pixels: Pixels, numbers: int) -> Network:
    """Müller et al., Instant NGP: tables of features on grids of several sizes, and a small network."""
    torch.manual_seed(0)
    network = nn.Sequential(
        nn.Linear(LEVELS * FEATURES, WIDTH), nn.ReLU(), nn.Linear(WIDTH, WIDTH), nn.ReLU(), nn.Linear(WIDTH, 3)
    )
    left = numbers - sum(number.numel() for number in network.parameters())
    finest = max(min(pixels.shape[:2]) / FINEST, COARSEST)
    sides = [round(COARSEST * (finest / COARSEST) ** (k / (LEVELS - 1))) for k in range(LEVELS)]
    wanted = [(side + 1) ** 2 for side in sides]
    most = max((t for t in range(1, left) if sum(min(t, w) for w in wanted) * FEATURES <= left), default=1)
    tables = [nn.Parameter(1e-4 * torch.randn(min(most, w), FEATURES)) for w in wanted]

    def colours(at: Tensor) -> Tensor:
        found = [_looked_up(table, side, at) for table, side in zip(tables, sides, strict=True)]
        return network(torch.cat(found, 1)) + 0.5  # type: ignore[no-any-return]

    return Network(colours, [*tables, *network.parameters()], RATE_OF_GRID)


class Training:
    """Adam on the squared error of random pixels."""

    def __init__(self, network: Network, pixels: Pixels, batch: int = BATCH) -> None:
        """batch: pixels of a step."""
        self.network, self.batch, self.shape = network, batch, pixels.shape
        self._colours = torch.tensor(pixels.reshape(-1, 3))
        self._optimiser = torch.optim.Adam(network.numbers, lr=network.rate)
        self._random = torch.Generator().manual_seed(0)

    def step(self) -> None:
        """One."""
        index = torch.randint(len(self._colours), (self.batch,), generator=self._random)
        self._optimiser.zero_grad()
        loss = ((self.network.colours(_places(index, self.shape)) - self._colours[index] / 255) ** 2).mean()
        loss.backward()  # type: ignore[no-untyped-call]
        self._optimiser.step()


@torch.no_grad()
def drawn(network: Network, shape: tuple[int, ...], apart: int = 1) -> Pixels:
    """The picture [H, W, 3] that it shows now. apart: of each so many rows and columns only the first."""
    some = torch.arange(shape[0] * shape[1]).reshape(shape[:2])[::apart, ::apart]
    every = some.reshape(-1)
    parts = [network.colours(_places(every[k : k + BATCH], shape)) for k in range(0, len(every), BATCH)]
    return levels_of(torch.cat(parts).numpy().reshape(*some.shape, 3))


def _places(index: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Of pixels by their numbers, x and y in [0, 1]."""
    height, width = shape[:2]
    return torch.stack([(index % width + 0.5) / width, (index // width + 0.5) / height], 1)


def levels_of(values: NDArray[Any]) -> Pixels:
    """8-bit pixels of values in [0, 1]."""
    return np.asarray(np.round(np.clip(values, 0, 1) * 255), np.uint8)


def _widest(numbers: int, of: Callable[[int], int]) -> int:
    """The width with which a network has at most so many."""
    return max((width for width in range(2, 2000) if of(width) <= numbers), default=2)


def _looked_up(table: Tensor, side: int, at: Tensor) -> Tensor:
    """Features between the four corners of each place's cell."""
    scaled = at * side
    corner = scaled.floor().clamp(max=side - 1)
    part = scaled - corner
    x, y = corner.long().unbind(1)
    total = torch.zeros(len(at), FEATURES)
    for dx in (0, 1):
        for dy in (0, 1):
            weight = (part[:, 0] if dx else 1 - part[:, 0]) * (part[:, 1] if dy else 1 - part[:, 1])
            dense = len(table) == (side + 1) ** 2
            index = (y + dy) * (side + 1) + x + dx if dense else ((x + dx) ^ ((y + dy) * 2654435761)) % len(table)
            total = total + weight[:, None] * table[index]
    return total
