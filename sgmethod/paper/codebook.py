"""Residual vector quantisation of colours, two stages of eight entries (GSImage; paper, section III-C)."""

from __future__ import annotations

import torch
from torch import Tensor

ROUNDS = 30  # of k-means


def kmeans(points: Tensor, weights: Tensor, entries: int, seed: int) -> Tensor:
    """Weighted k-means, started by k-means++: points [N, D], weights [N] >= 0 -> centres [entries, D]."""
    generator = torch.Generator().manual_seed(seed)
    weights = weights + 1e-12
    centres = points[torch.multinomial(weights, 1, generator=generator)]
    while len(centres) < entries:
        distance = torch.cdist(points, centres).square().amin(1) * weights + 1e-12
        centres = torch.cat([centres, points[torch.multinomial(distance, 1, generator=generator)]])
    for _ in range(ROUNDS):
        centres = _means(points, weights, torch.cdist(points, centres).argmin(1), centres)
    return centres


def _means(points: Tensor, weights: Tensor, index: Tensor, fallback: Tensor) -> Tensor:
    """Weighted mean [K, D] of the points of each index; the fallback [K, D] for an index without points."""
    total = torch.zeros(len(fallback), dtype=torch.float32).index_add_(0, index, weights)
    sums = torch.zeros_like(fallback).index_add_(0, index, points * weights[:, None])
    return torch.where(total[:, None] > 0, sums / total.clamp_min(1e-20)[:, None], fallback)


class ResidualCodebook:
    """Two codebooks [2, 8, 3]; a colour is the sum of one entry of each.

    The entries follow the colours by an exponential moving average, as in GSImage.
    """

    def __init__(self, colors: Tensor, weights: Tensor, *, stages: int, entries: int, decay: float, seed: int):
        self.decay = decay
        residual, books = colors, []
        for stage in range(stages):
            centres = kmeans(residual, weights, entries, seed + stage)
            residual = residual - centres[torch.cdist(residual, centres).argmin(1)]
            books.append(centres)
        self.entries = torch.stack(books)

    def assign(self, colors: Tensor) -> Tensor:
        """Find the pair of entries nearest to each colour [N, 3], over all pairs; returns indices [N, 2]."""
        first, second = self.entries
        pairs = (first[:, None] + second[None]).reshape(-1, 3)
        best = torch.cdist(colors, pairs).argmin(1)
        return torch.stack([best // len(second), best % len(second)], 1)

    def lookup(self, index: Tensor) -> Tensor:
        """Return the colours [N, 3] of indices [N, 2]."""
        return self.entries[0][index[:, 0]] + self.entries[1][index[:, 1]]

    def follow(self, colors: Tensor, weights: Tensor, index: Tensor) -> None:
        """Move each entry by 1 - decay of the way to the weighted mean of the colours it represents."""
        for stage in range(len(self.entries)):
            others = self.lookup(index) - self.entries[stage][index[:, stage]]
            target = _means(colors - others, weights, index[:, stage], self.entries[stage])
            self.entries[stage] += (1 - self.decay) * (target - self.entries[stage])
