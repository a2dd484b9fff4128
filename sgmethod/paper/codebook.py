"""Residual vector quantisation of colours, two stages of eight entries (GaussianImage; paper, section IV-A)."""

from __future__ import annotations

import torch
from torch import Tensor

ROUNDS = 30  # of k-means


def kmeans(points: Tensor, entries: int, seed: int) -> Tensor:
    """K-means, started by k-means++: points [N, D] -> centres [entries, D]."""
    generator = torch.Generator().manual_seed(seed)
    centres = points[torch.randint(len(points), (1,), generator=generator)]
    while len(centres) < entries:
        distance = torch.cdist(points, centres).square().amin(1) + 1e-12
        centres = torch.cat([centres, points[torch.multinomial(distance, 1, generator=generator)]])
    for _ in range(ROUNDS):
        centres = _means(points, torch.cdist(points, centres).argmin(1), centres)
    return centres


def _means(points: Tensor, index: Tensor, fallback: Tensor) -> Tensor:
    """Mean [K, D] of the points of each index; the fallback [K, D] for an index without points."""
    total = torch.bincount(index, minlength=len(fallback))[:, None]
    sums = torch.zeros_like(fallback).index_add_(0, index, points)
    return torch.where(total > 0, sums / total.clamp_min(1), fallback)


class ResidualCodebook:
    """Two codebooks [2, 8, 3]: a colour is the sum of an entry of each.

    The entries follow the colours by an exponential moving average. Colours are assigned over all pairs, which is ours:
    stage by stage, entries that move change the second stage of many at once, and tuning diverges.
    """

    def __init__(self, colors: Tensor, *, stages: int, entries: int, decay: float, seed: int):
        self.decay = decay
        residual, books = colors, []
        for stage in range(stages):
            books.append(kmeans(residual, entries, seed + stage))
            residual = residual - books[-1][torch.cdist(residual, books[-1]).argmin(1)]
        self.entries = torch.stack(books)

    def assign(self, colors: Tensor) -> Tensor:
        """Find the pair of entries nearest to each colour [N, 3]; returns indices [N, 2]."""
        first, second = self.entries
        best = torch.cdist(colors, (first[:, None] + second).reshape(-1, 3)).argmin(1)
        return torch.stack([best // len(second), best % len(second)], 1)

    def lookup(self, index: Tensor) -> Tensor:
        """Return the colours [N, 3] of indices [N, 2]."""
        return self.entries[0][index[:, 0]] + self.entries[1][index[:, 1]]

    def update(self, colors: Tensor, index: Tensor) -> None:
        """Move each entry by 1 - decay of the way to the mean of what the other stage leaves to it."""
        for stage in range(len(self.entries)):
            others = self.lookup(index) - self.entries[stage][index[:, stage]]
            target = _means(colors - others, index[:, stage], self.entries[stage])
            self.entries[stage] += (1 - self.decay) * (target - self.entries[stage])
