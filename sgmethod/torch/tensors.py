"""The backend of fits on devices of PyTorch other than the CPU."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from sgmethod.backend.kernels import Kernels
from sgmethod.backend.planes import all_halved
from sgmethod.backend.protocol import TARGET_WHITE, Descent, Frame, Moments, Target, Visibility
from sgmethod.scene import FloatArray, Gaussians
from sgmethod.torch.pairs import Pairs

Backward = Callable[[Tensor], tuple[Tensor, Tensor, Tensor]]  # a gradient by a picture -> by its Gaussians' parameters


class Tensors(Kernels):
    """A Backend on a device, in single precision, for fits in which all pixels count alike.

    Whatever reads all pixels runs on the device, by operations on tensors. Other work on each Gaussian alone stays with
    the kernels on the CPU. Results vary from run to run if the device's sums do.
    """

    def __init__(self, device: torch.device) -> None:
        self._device = device

    def residual(
        self, gaussians: Gaussians, frame: Frame, target: Target, first_row: int = 0, *, half: bool = False
    ) -> FloatArray:
        drawn = self._drawn(gaussians, frame)[0][:, first_row : first_row + target.shape[1]]
        missing = to_numpy(self._image(target) - drawn)
        return all_halved(missing) if half else missing

    def error(self, gaussians: Gaussians, frame: Frame, target: Target, visibility: Visibility | None = None) -> float:
        assert visibility is None
        return _mean_square(self._drawn(gaussians, frame)[0] - self._image(target))

    def gradients(
        self, gaussians: Gaussians, frame: Frame, target: Target, visibility: Visibility | None = None
    ) -> tuple[float, Gaussians]:
        assert visibility is None
        drawn, backward = self._drawn(gaussians, frame)
        left = drawn - self._image(target)
        return _mean_square(left), Gaussians(*map(to_numpy, backward(left * (2 / left.numel()))))

    def gram(self, gaussians: Gaussians, frame: Frame, visibility: Visibility | None = None) -> FloatArray:
        assert visibility is None
        drawn, backward = self._drawn(gaussians, frame)
        return to_numpy(backward(drawn)[2])

    def steps(self, gaussians: Gaussians, moments: Moments, descent: Descent, rates: Sequence[float]) -> list[float]:
        d, errors = descent, []
        for rate in rates:
            error, gradient = self.gradients(gaussians, d.frame, d.target, d.visibility)
            if d.price > 0:
                self.add_rate_gradient(gaussians, gradient, d.quantum, d.price)
            self.step(gaussians, gradient, moments, d, rate)
            self.keep_in_range(gaussians, d.width, d.height)
            errors.append(error)
        return errors

    def _drawn(self, gaussians: Gaussians, frame: Frame) -> tuple[Tensor, Backward]:
        """Draw Gaussians: a picture [3, height, width], and the function that backpropagates a gradient by it."""
        means, factors, colors = map(self._tensor, gaussians.arrays)
        size = frame.width, frame.height
        pairs = Pairs(means / frame.spacing, factors / frame.spacing, size, frame.cutoff, frame.pyramid)

        def backward(by_image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
            by_means, by_factors, by_colors = pairs.gradients(colors, by_image)
            return by_means / frame.spacing, by_factors / frame.spacing, by_colors

        return pairs.draw(colors), backward

    def _image(self, target: Target) -> Tensor:
        return self._tensor(target).to(torch.float32) / TARGET_WHITE

    def _tensor(self, values: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(values)).to(self._device)


def _mean_square(values: Tensor) -> float:
    """Mean square, of rows on the device and over them in double precision on the CPU, as not every device has it."""
    return float((values * values).mean(2).cpu().double().mean())


def to_numpy(values: Tensor) -> FloatArray:
    """Copy a tensor to an array."""
    return np.ascontiguousarray(values.cpu().numpy())
