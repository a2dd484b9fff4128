"""Networks that give a colour for each place, as benchmarks.convergence.network trains them: I-NGP and NeuRBF.

I-NGP: Müller et al., "Instant Neural Graphics Primitives with a Multiresolution Hash Encoding", 2022. Features on
grids from coarse to fine, the fine ones in tables that hash collisions share, and a small network on top of them.

NeuRBF: Chen et al., "NeuRBF: A Neural Fields Representation with Adaptive Radial Basis Functions", 2023. Half of the
numbers are such grids. The other half are anisotropic radial bases, more of them where the picture has detail, whose
centres, shapes and features are learned; each feature sees its basis through a sine of its own frequency.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.convergence.network import Network
from benchmarks.others.splats import places_with_detail
from benchmarks.pictures import Pixels

LEVELS, FEATURES, COARSEST = 12, 2, 8  # of grids; features of a node; nodes of the coarsest along a side
PRIME = 2_654_435_761
WIDTH = 64  # of the two hidden layers
RATE, EPS = 1e-2, 1e-15  # of Adam
BATCH = 1 << 10  # pixels of a step: the best of 2^10, 2^12 and 2^14 after 8 s, on two other photographs
BASES, NEAREST, HIGHEST = 8, 4, 8.0  # features of a basis; bases at a place; frequency


class Grids:
    """Features of places [K, 2] in [0, 1], from tables with a limited amount of numbers."""

    outputs = LEVELS * FEATURES

    def __init__(self, numbers: int, finest: int) -> None:
        """finest: nodes of the finest grid along a side."""
        sides = np.geomspace(COARSEST, max(finest, COARSEST + 1), LEVELS).round().astype(int)
        nodes = (sides + 1) ** 2
        most = next(n for n in range(numbers // FEATURES, 0, -1) if np.minimum(nodes, n).sum() <= numbers // FEATURES)
        sizes = np.minimum(nodes, most)
        self._sides, self._sizes = torch.tensor(sides), torch.tensor(sizes)
        self._first = self._sizes.cumsum(0) - self._sizes
        self.table = nn.Parameter(torch.empty(int(sizes.sum()), FEATURES).uniform_(-1e-4, 1e-4))

    def __call__(self, at: Tensor) -> Tensor:
        """Features [K, outputs] of places."""
        x = at[:, None] * self._sides[:, None]  # [K, LEVELS, 2]
        low = x.floor()
        part, found = x - low, torch.zeros(len(at), LEVELS, FEATURES)
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            column, row = (low + torch.tensor([dx, dy])).long().unbind(2)
            dense, hashed = row * (self._sides + 1) + column, column ^ (row * PRIME)
            index = torch.where(self._sizes == (self._sides + 1) ** 2, dense, hashed) % self._sizes + self._first
            weight = (part[..., 0] if dx else 1 - part[..., 0]) * (part[..., 1] if dy else 1 - part[..., 1])
            found = found + weight[..., None] * functional.embedding(index, self.table)
        return found.flatten(1)


class Bases:
    """Features of places [K, 2] in [0, 1], from the nearest of the bases."""

    outputs = BASES

    def __init__(self, numbers: int, pixels: Pixels) -> None:
        height, width = pixels.shape[:2]
        centres = places_with_detail(pixels, max(numbers // (2 + 3 + BASES), NEAREST + 1))
        apart = cKDTree(centres).query(centres, NEAREST + 1)[0][:, -1]
        rows, columns = np.indices((height, width)) + 0.5
        near = cKDTree(centres).query(np.stack([columns.ravel(), rows.ravel()], 1), NEAREST)[1]
        self._near, self._size = torch.tensor(near), torch.tensor([width, height])
        self.centres = nn.Parameter(torch.tensor(centres, dtype=torch.float32))
        inverse = torch.tensor(1 / np.maximum(apart, 0.5), dtype=torch.float32)
        self.shapes = nn.Parameter(torch.stack([inverse, 0 * inverse, inverse], 1))
        self.features = nn.Parameter(torch.empty(len(centres), BASES).uniform_(-0.1, 0.1))
        self._frequencies = torch.logspace(0, 1, BASES, HIGHEST)

    def __call__(self, at: Tensor) -> Tensor:
        """Features [K, outputs] of places."""
        at = at * self._size
        column, row = at.long().unbind(1)
        near = self._near[row * self._size[0] + column]  # [K, NEAREST]
        dx, dy = (at[:, None] - self.centres[near]).unbind(2)
        a, b, c = self.shapes[near].unbind(2)
        basis = 1 / (1 + (a * dx).square() + (b * dx + c * dy).square())
        return (torch.sin(basis[..., None] * self._frequencies) * functional.embedding(near, self.features)).sum(1)


def ingp(numbers: int, pixels: Pixels) -> Network:
    """A network with a limited amount of numbers."""
    torch.manual_seed(0)
    layers = perceptron(Grids.outputs)
    grids = Grids(numbers - count(layers), max(pixels.shape) // 2)
    return Network(lambda at: layers(grids(at)), [grids.table, *layers.parameters()], RATE, EPS, BATCH)


def neurbf(numbers: int, pixels: Pixels) -> Network:
    """A network with a limited amount of numbers."""
    torch.manual_seed(0)
    layers = perceptron(Grids.outputs + Bases.outputs)
    grids = Grids((numbers - count(layers)) // 2, max(pixels.shape) // 2)
    bases = Bases(numbers - count(layers) - grids.table.numel(), pixels)

    def colours(at: Tensor) -> Tensor:
        found: Tensor = layers(torch.cat([grids(at), bases(at)], 1))
        return found

    learned = [grids.table, bases.centres, bases.shapes, bases.features]
    return Network(colours, [*learned, *layers.parameters()], RATE, EPS, BATCH)


def perceptron(inputs: int) -> nn.Sequential:
    """A small network from features to colours."""
    layers = [layer for a, b in pairwise([inputs, WIDTH, WIDTH, 3]) for layer in (nn.Linear(a, b), nn.ReLU())]
    return nn.Sequential(*layers[:-1])


def count(layers: nn.Module) -> int:
    """The number of parameters."""
    return sum(number.numel() for number in layers.parameters())
