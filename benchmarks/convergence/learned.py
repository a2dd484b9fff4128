"""Other ways to fit the same picture: plain Adam on the raw numbers of Gaussians, and two networks of the file's bytes.

Each yields its picture at growing times. The clock stands while a picture is drawn and measured.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from benchmarks.pictures import Pixels
from sgmethod.fitting.parameters import Parameters
from sgmethod.fitting.picture import Picture, target_of
from sgmethod.native import native
from sgmethod.profiles import BASELINE
from sgmethod.start.placement import place

Shown = Iterator[tuple[float, Pixels]]  # seconds, [H, W, 3]
FIRST_S, GROWTH = 0.1, 1.25  # when the picture is looked at
# Each the best of those tried, by the PSNR after 400 steps on astronaut at 128x128: 0.02, 0.05, 0.1, 0.2 for all raw
# numbers of 600 Gaussians alike; 5e-4, 1e-3, 2e-3, 8e-3 and 3e-3, 1e-2, 3e-2 for networks of 2 bits per pixel.
RATE_OF_ADAM, RATE_OF_SIREN, RATE_OF_GRID = 0.2, 1e-3, 3e-2
BATCH = 1 << 14  # pixels of a step
HIDDEN_LAYERS = 4
LEVELS, FEATURES, WIDTH = 8, 2, 16  # of the hash grid: levels, numbers of an entry, neurons of a layer
COARSEST, FINEST = 8, 4  # cells along the first level's side, pixels of a cell of the last
BYTES_OF_NUMBER = 2  # half precision, as COIN stores them


def plain_adam(pixels: Pixels, seconds: float, gaussians: int) -> Shown:
    """Gaussians from a random start, all their raw numbers moved by torch's Adam; what is shown is no file."""
    began = time.perf_counter()
    torch.set_num_threads(1)  # or its threads and the kernels' would wait for each other
    start = place(pixels.astype(np.float32) / np.float32(255), gaussians, BASELINE, np.random.default_rng(0))
    picture = Picture(target_of(pixels), 0.0, native.CUTOFF_V3)
    p = Parameters.of(start)
    optimiser = torch.optim.Adam(p.tensors(), lr=RATE_OF_ADAM)

    def step() -> None:
        _, gradients = picture.gradients(p)
        for tensor, gradient in zip(p.tensors(), gradients.tensors(), strict=True):
            tensor.grad = gradient
        optimiser.step()
        with torch.no_grad():
            p.factors[:, 0::2].clamp_(min=BASELINE.min_scale_px)
            p.colors.clamp_(-2, 2)

    def show() -> Pixels:
        drawn = pixels / np.float32(255) - picture.residual(p)(0, pixels.shape[0]).transpose(1, 2, 0)
        return levels_of(drawn)

    yield from watched(step, show, seconds, began)


class Siren(nn.Module):
    """Sitzmann et al.: sines of sines. hidden: layers between the first and the last."""

    def __init__(self, width: int, hidden: int) -> None:
        super().__init__()
        torch.manual_seed(0)
        layers = [nn.Linear(a, b) for a, b in pairwise([2, *[width] * (hidden + 1), 3])]
        self.layers = nn.ModuleList(layers)
        with torch.no_grad():
            for k, layer in enumerate(layers):
                reach = 1 / 2 if k == 0 else math.sqrt(6 / layer.in_features) / 30
                layer.weight.uniform_(-reach, reach)

    def forward(self, at: Tensor) -> Tensor:
        """Colours in [0, 1] at places in [0, 1]."""
        *inner, last = self.layers
        x = at * 2 - 1
        for layer in inner:
            x = torch.sin(30 * layer(x))
        return last(x) / 2 + 0.5  # type: ignore[no-any-return]


def width_within(size: int, hidden: int) -> int:
    """The widest Siren of at most so many bytes."""

    def numbers(width: int) -> int:
        return 3 * width + hidden * (width + 1) * width + 3 * (width + 1)

    return max((w for w in range(2, 2000) if BYTES_OF_NUMBER * numbers(w) <= size), default=2)


def siren(pixels: Pixels, seconds: float, size: int) -> Shown:
    """Four hidden layers, as wide as so many bytes allow."""
    began = time.perf_counter()
    network = Siren(width_within(size, HIDDEN_LAYERS), HIDDEN_LAYERS)
    yield from trained(network, list(network.parameters()), RATE_OF_SIREN, pixels, seconds, began)


def hash_grid(pixels: Pixels, seconds: float, size: int) -> Shown:
    """Müller et al., Instant NGP: tables of features on grids of several sizes, and a small network."""
    began = time.perf_counter()
    torch.manual_seed(0)
    network = nn.Sequential(
        nn.Linear(LEVELS * FEATURES, WIDTH), nn.ReLU(), nn.Linear(WIDTH, WIDTH), nn.ReLU(), nn.Linear(WIDTH, 3)
    )
    left = size // BYTES_OF_NUMBER - sum(number.numel() for number in network.parameters())
    finest = max(min(pixels.shape[:2]) / FINEST, COARSEST)
    sides = [round(COARSEST * (finest / COARSEST) ** (k / (LEVELS - 1))) for k in range(LEVELS)]
    wanted = [(side + 1) ** 2 for side in sides]
    most = max((t for t in range(1, left) if sum(min(t, w) for w in wanted) * FEATURES <= left), default=1)
    tables = [nn.Parameter(1e-4 * torch.randn(min(most, w), FEATURES)) for w in wanted]

    def shown(at: Tensor) -> Tensor:
        found = [_looked_up(table, side, at) for table, side in zip(tables, sides, strict=True)]
        return network(torch.cat(found, 1)) + 0.5  # type: ignore[no-any-return]

    yield from trained(shown, [*tables, *network.parameters()], RATE_OF_GRID, pixels, seconds, began)


def watched(step: Callable[[], None], show: Callable[[], Pixels], seconds: float, began: float) -> Shown:
    """Repeat a step for so many seconds, and show what has become at times that grow by a factor."""
    due, stood = FIRST_S, 0.0
    while True:
        step()
        run = time.perf_counter() - began - stood
        if run >= min(due, seconds):
            paused = time.perf_counter()
            yield run, show()
            stood += time.perf_counter() - paused
            if run >= seconds:
                return
            due = run * GROWTH


def levels_of(values: NDArray[Any]) -> Pixels:
    """8-bit pixels of values in [0, 1]."""
    return np.asarray(np.round(np.clip(values, 0, 1) * 255), np.uint8)


def trained(
    network: Callable[[Tensor], Tensor],
    numbers: list[nn.Parameter],
    rate: float,
    pixels: Pixels,
    seconds: float,
    began: float,
) -> Shown:
    """Adam on the squared error of random pixels; what is shown has its numbers rounded to half precision."""
    torch.set_num_threads(native.thread_count())
    colours = torch.tensor(pixels.reshape(-1, 3))
    optimiser = torch.optim.Adam(numbers, lr=rate)
    random = torch.Generator().manual_seed(0)

    def step() -> None:
        index = torch.randint(len(colours), (BATCH,), generator=random)
        optimiser.zero_grad()
        loss = ((network(places(index, pixels.shape)) - colours[index] / 255) ** 2).mean()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()

    @torch.no_grad()
    def show() -> Pixels:
        kept = [number.clone() for number in numbers]
        for number in numbers:
            number.copy_(number.half().float())
        picture = drawn(network, pixels.shape)
        for number, value in zip(numbers, kept, strict=True):
            number.copy_(value)
        return picture

    yield from watched(step, show, seconds, began)


@torch.no_grad()
def drawn(network: Callable[[Tensor], Tensor], shape: tuple[int, ...]) -> Pixels:
    """The picture [H, W, 3] that a network shows."""
    every = torch.arange(shape[0] * shape[1])
    parts = [network(places(every[first : first + BATCH], shape)) for first in range(0, len(every), BATCH)]
    return levels_of(torch.cat(parts).numpy().reshape(*shape[:2], 3))


def places(index: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Of pixels by their numbers, x and y in [0, 1]."""
    height, width = shape[:2]
    return torch.stack([(index % width + 0.5) / width, (index // width + 0.5) / height], 1)


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
