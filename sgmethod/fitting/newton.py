"""Gauss-Newton with momentum, in each Gaussian's own frame.

A Gaussian's own part of the squared error's curvature is known without a measurement, and in its own frame it is
diagonal. A step divides the gradient by it. Where Adam divides by the gradient's own size, so that each step is as
long as the last one, steps become short here as the gradient does: nothing jumps once the fit is close. Neighbours that
overlap add curvature that is not known; Gaussians that overshoot ease (sgmethod/native/fit/optimiser.h).
"""

from __future__ import annotations

import torch
from torch import Tensor

from sgmethod.fitting.parameters import Parameters
from sgmethod.native import native
from sgmethod.profiles import RdSettings


class FrameNewton:
    """Steps on (d, S, colour), 8 numbers a Gaussian: the mean moves by L d and the factor by L S."""

    def __init__(self, n: int, settings: RdSettings) -> None:
        s = settings
        self._settings = native.NewtonSettings(
            s.newton_rate, s.most_frame, s.most_color, s.faint, s.momentum, s.min_scale_px
        )
        self.momentum = torch.zeros(n, 8)
        self.state = _new(n)

    def select(self, index: Tensor) -> None:
        """Keep the Gaussians of these rows."""
        self.momentum, self.state = self.momentum[index], self.state[index]

    def extend(self, count: int) -> None:
        """Append new Gaussians."""
        self.momentum = torch.cat([self.momentum, torch.zeros(count, 8)])
        self.state = torch.cat([self.state, _new(count)])

    def step(self, p: Parameters, grad: Parameters, rate: float, values: int) -> None:
        """Move p, in place, against its gradients; rate scales the rate. values: numbers of the picture."""
        # Not arrays(): a copy would move in p's place.
        moved = p.means.numpy(), p.factors.numpy(), p.colors.numpy()
        state = self.momentum.numpy(), self.state.numpy()
        native.frame_newton(self._settings, rate, values, *moved, *grad.arrays(), *state)


def _new(n: int) -> Tensor:
    """Of Gaussians that have made no step: beta^0, not eased."""
    return torch.tensor([1.0, 0.0]).repeat(n, 1)
