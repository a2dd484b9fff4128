"""Adam in each Gaussian's own frame.

With the factor L, a mean moves by L d and the factor by L S, S lower triangular. So a rate means the same relative
change for a speck and for a wide, tilted ellipse. On five photographs that was worth as much as three times the steps
of Adam on plain parameters.

Adam's steps have the length of the rate even where next to nothing is left to gain. So profile rd takes the shorter of
that and of a few steps of Gauss-Newton, whose matrix is known in the frame and taken for diagonal. That halves the
steps that a fit needs.
"""

from __future__ import annotations

import torch
from torch import Tensor

from sgmethod.fitting.parameters import Parameters
from sgmethod.native import native
from sgmethod.profiles import OptimiserSettings


class FrameAdam:
    """Adam on (d, S, colour), 8 numbers a Gaussian (see the module's text)."""

    def __init__(self, n: int, settings: OptimiserSettings, values: int = 1) -> None:
        """values: of the picture, whose mean squared error is the loss. They matter where newton_steps is finite."""
        s = settings
        rates = (s.mean_rate, s.factor_rate, s.color_rate)
        self._settings = native.AdamSettings(*rates, s.beta1, s.beta2, s.min_scale_px, s.newton_steps, values)
        self.first, self.second = torch.zeros(n, 8), torch.zeros(n, 8)
        self.bias = torch.ones(n, 2)  # beta^steps; Gaussians that come later start their averages anew

    def select(self, index: Tensor) -> None:
        """Keep the Gaussians of these rows."""
        self.first, self.second, self.bias = self.first[index], self.second[index], self.bias[index]

    def extend(self, count: int) -> None:
        """Append new Gaussians."""
        self.first = torch.cat([self.first, torch.zeros(count, 8)])
        self.second = torch.cat([self.second, torch.zeros(count, 8)])
        self.bias = torch.cat([self.bias, torch.ones(count, 2)])

    def step(self, p: Parameters, grad: Parameters, rate: float) -> None:
        """Move p, in place, against its gradients; rate scales all rates."""
        moments = self.first.numpy(), self.second.numpy(), self.bias.numpy()
        # Not arrays(): a copy would move in p's place.
        native.frame_adam(
            self._settings, rate, p.means.numpy(), p.factors.numpy(), p.colors.numpy(), *grad.arrays(), *moments
        )
