"""Adam, of a few tensors with a rate each."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

EPSILON = 1e-15


class Adam:
    """Adam in the operations of torch.optim.Adam, of which the first use loads a compiler for seconds."""

    def __init__(self, parameters: Sequence[Tensor], rates: Sequence[float], betas: tuple[float, float]) -> None:
        self._parameters, self._rates, self._betas, self._steps = parameters, rates, betas, 0
        self._moments = [(torch.zeros_like(one), torch.zeros_like(one)) for one in parameters]

    def step(self, gradients: Sequence[Tensor], rate: float) -> None:
        """Take a step of all parameters, at `rate` times their own rates."""
        self._steps += 1
        first, second = self._betas
        unbiased, root = 1 - first**self._steps, (1 - second**self._steps) ** 0.5
        for parameter, own, gradient, (mean, square) in zip(
            self._parameters, self._rates, gradients, self._moments, strict=True
        ):
            mean.lerp_(gradient, 1 - first)
            square.mul_(second).addcmul_(gradient, gradient, value=1 - second)
            parameter.addcdiv_(mean, (square.sqrt() / root).add_(EPSILON), value=-(own * rate / unbiased))
