"""Gaussians as tensors of torch, for autograd through the paper's quantisers."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from sgmethod.scene import Gaussians


@dataclass(frozen=True)
class Parameters:
    """Tensors of N Gaussians: means [N, 2], factors [N, 3] (pixels), colors [N, 3]."""

    means: Tensor
    factors: Tensor
    colors: Tensor

    @classmethod
    def of(cls, gaussians: Gaussians) -> Parameters:
        """Copy arrays to tensors."""
        return cls(*(torch.tensor(values) for values in gaussians.arrays))

    @classmethod
    def sharing(cls, gaussians: Gaussians) -> Parameters:
        """Wrap arrays in tensors that share their memory."""
        return cls(*(torch.from_numpy(values) for values in gaussians.arrays))

    def numpy(self) -> Gaussians:
        """Return arrays, which share the tensors' memory where that is contiguous."""
        return Gaussians(*(values.detach().contiguous().numpy() for values in (self.means, self.factors, self.colors)))
