"""Gaussians as a fit moves them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from sgmethod.scene import FloatArray, Gaussians


@dataclass
class Parameters:
    """Gaussians as tensors: means [N, 2], factors [N, 3] (pixels), colors [N, 3]."""

    means: Tensor
    factors: Tensor
    colors: Tensor

    @classmethod
    def of(cls, gaussians: Gaussians) -> Parameters:
        """A copy of plain arrays."""
        return cls(*(torch.tensor(a) for a in (gaussians.means, gaussians.factors, gaussians.colors)))

    @classmethod
    def empty(cls, n: int) -> Parameters:
        """n Gaussians whose values are not set, for kernels to fill."""
        return cls(torch.empty(n, 2), torch.empty(n, 3), torch.empty(n, 3))

    def alike(self) -> Parameters:
        """As many Gaussians whose values are not set."""
        return Parameters.empty(len(self.means))

    def copy(self) -> Parameters:
        """The same values in memory of their own."""
        return Parameters(*(values.clone() for values in self.tensors()))

    def with_more(self, new: Parameters) -> Parameters:
        """These and after them new ones."""
        return Parameters(*(torch.cat(pair) for pair in zip(self.tensors(), new.tensors(), strict=True)))

    def tensors(self) -> tuple[Tensor, Tensor, Tensor]:
        """(means, factors, colors)."""
        return self.means, self.factors, self.colors

    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """For kernels: (means, factors, colors), which share the tensors' memory where that is contiguous."""
        return self.means.contiguous().numpy(), self.factors.contiguous().numpy(), self.colors.contiguous().numpy()

    def numpy(self) -> Gaussians:
        """Plain Gaussians of the same arrays."""
        return Gaussians(*self.arrays())

    def rows(self, index: Tensor) -> Parameters:
        """The Gaussians of these rows, in their order."""
        return Parameters(self.means[index], self.factors[index], self.colors[index])
