"""The backend for devices of PyTorch other than the CPU.

Whatever reads all pixels runs on the device, by Triton's kernels (tiles.py), or by operations on tensors (pairs.py).
So do steps of the optimiser by Triton's kernels, if all pixels count alike. Other work on each Gaussian alone, and the
final search over integers, stay with the kernels on the CPU.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, conv2d, pad

from sgmethod.backend.kernels import Kernels
from sgmethod.backend.pairs import Pairs
from sgmethod.backend.planes import all_halved
from sgmethod.backend.protocol import (
    COARSE_SIDE,
    TARGET_WHITE,
    VISIBLE,
    Descent,
    Frame,
    Loss,
    Moments,
    Target,
    Visibility,
    step_by_step,
)
from sgmethod.scene import FloatArray, Gaussians

if TYPE_CHECKING:
    from sgmethod.backend.tiles import Tiles


class Tensors(Kernels):
    """A Backend on a device, in single precision. Files vary from run to run if the device's sums do.

    tiled: whether Triton's kernels run there.
    """

    def __init__(self, device: torch.device, tiled: bool = False) -> None:
        self._device, self._tiled = device, tiled

    def residual(
        self, gaussians: Gaussians, frame: Frame, target: Target, first_row: int = 0, *, half: bool = False
    ) -> FloatArray:
        drawn = self._drawn(gaussians, frame)[1][:, first_row : first_row + target.shape[1]]
        missing = _numpy(self._image(target) - drawn)
        return all_halved(missing) if half else missing

    def error(self, gaussians: Gaussians, frame: Frame, target: Target, visibility: Visibility | None = None) -> float:
        left = self._drawn(gaussians, frame)[1] - self._image(target)
        return _mean(left * self._seen(_with_coarse(left, frame, visibility), visibility))

    def gradients(
        self, gaussians: Gaussians, frame: Frame, target: Target, visibility: Visibility | None = None
    ) -> tuple[float, Gaussians]:
        pairs, drawn = self._drawn(gaussians, frame)
        left = drawn - self._image(target)
        seen = self._seen(_with_coarse(left, frame, visibility), visibility)
        return _mean(left * seen), self._gradient(pairs, gaussians, frame, seen * (2 / left.numel()))

    def regularised(self, frame: Frame, image: FloatArray, lambda_g: float) -> Loss:
        target = self._tensor(image)
        along_x = self._tensor(np.array([[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]], np.float32))
        kernels = torch.stack([along_x, along_x.T])[:, None]

        def evaluate(gaussians: Gaussians) -> tuple[float, Gaussians]:
            pairs, drawn = self._drawn(gaussians, frame)
            with torch.enable_grad():  # even if the caller has disabled gradients
                drawn.requires_grad_()
                mse = loss = (drawn - target).square().mean()
                if min(target.shape[1:]) >= 3:
                    found, wanted = (conv2d(one[:, None], kernels) for one in (drawn, target))
                    loss = mse + lambda_g * (wanted.abs() * (found - wanted).square()).sum() / target.numel()
                (by_image,) = torch.autograd.grad(loss, drawn)
            return mse.item(), self._gradient(pairs, gaussians, frame, by_image)

        return evaluate

    def gram(self, gaussians: Gaussians, frame: Frame, visibility: Visibility | None = None) -> FloatArray:
        pairs, drawn = self._drawn(gaussians, frame)
        alike = None if visibility is None else Visibility(visibility.values, by_eye=False)
        return self._gradient(pairs, gaussians, frame, self._seen(drawn, alike)).colors

    def steps(self, gaussians: Gaussians, moments: Moments, descent: Descent, rates: Sequence[float]) -> None:
        if self._tiled and descent.visibility is None:
            self.steps_of([(gaussians, moments, descent)], rates)
        else:
            step_by_step(self, gaussians, moments, descent, rates)

    def steps_of(self, fits: Sequence[tuple[Gaussians, Moments, Descent]], rates: Sequence[float]) -> None:
        """Take the steps of several fits, whose frames, sizes and settings are alike, by Triton's kernels.

        From the first step to the last nothing leaves the device.
        """
        from sgmethod.backend.tiles import Tiles

        most = max(len(gaussians) for gaussians, _, _ in fits)
        arrays = [(*one.arrays, moments.first, moments.second, moments.bias) for one, moments, _ in fits]
        filled = ([np.pad(one, ((0, most - len(one)), (0, 0))) for one in of] for of in zip(*arrays, strict=True))
        state = [self._tensor(np.stack(values)) for values in filled]
        descents = [descent for _, _, descent in fits]
        target = torch.stack([self._image(one.target) for one in descents])
        quanta = [one.quantum if one.price > 0 else 1.0 for one in descents]  # it may be 0 where bits are free
        prices = [one.price for one in descents]
        bits = [self._tensor(np.array(of, np.float32)) for of in (quanta, prices)]
        for rate in rates:
            Tiles(descents[0].frame, *state[:3]).step(state[3:], bits, target, descents[0], rate)
        for values, of in zip(state, zip(*arrays, strict=True), strict=True):
            for found, one in zip(_numpy(values), of, strict=True):
                one[...] = found[: len(one)]

    def _drawn(self, gaussians: Gaussians, frame: Frame) -> tuple[Pairs | Tiles, Tensor]:
        means, factors, colors = map(self._tensor, gaussians.arrays)
        if self._tiled:
            from sgmethod.backend.tiles import Tiles

            tiles = Tiles(frame, means[None], factors[None], colors[None])
            return tiles, tiles.draw()[0]
        size = frame.width, frame.height
        pairs = Pairs(means / frame.spacing, factors / frame.spacing, size, frame.cutoff, frame.pyramid)
        return pairs, pairs.draw(colors)

    def _gradient(self, drawn: Pairs | Tiles, gaussians: Gaussians, frame: Frame, by_image: Tensor) -> Gaussians:
        if isinstance(drawn, Pairs):
            means, factors, colors = drawn.gradients(self._tensor(gaussians.colors), by_image)
            means, factors = means / frame.spacing, factors / frame.spacing
        else:
            means, factors, colors = (values[0] for values in drawn.gradients(by_image[None]))
        return Gaussians(_numpy(means), _numpy(factors), _numpy(colors))

    def _seen(self, errors: Tensor, visibility: Visibility | None) -> Tensor:
        """Errors [3, H, W] times their weights; multiplied by the errors, this gives weighted squares."""
        if visibility is None:
            return errors
        color = self._tensor(visibility.color.astype(np.float32))
        weights = self._tensor(visibility.values).to(errors.dtype) / VISIBLE
        return torch.einsum("ab,byx->ayx", color, errors) * weights

    def _image(self, target: Target) -> Tensor:
        return self._tensor(target).to(torch.float32) / TARGET_WHITE

    def _tensor(self, values: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(values)).to(self._device)


def _with_coarse(errors: Tensor, frame: Frame, visibility: Visibility | None) -> Tensor:
    """Add the mean of each square, times the weight of coarse errors, to errors [3, H, W]."""
    if visibility is None or visibility.coarse == 0:
        return errors
    _, height, width = errors.shape
    side = max(COARSE_SIDE // frame.spacing, 1)
    means = avg_pool2d(pad(errors, (0, -width % side, 0, -height % side)), side)
    means = means.repeat_interleave(side, 1).repeat_interleave(side, 2)[:, :height, :width]
    return errors + visibility.coarse * means


def _mean(values: Tensor) -> float:
    """Mean, of rows on the device and over them in double precision on the CPU, since not every device has it."""
    return float(values.mean(2).cpu().double().mean())


def _numpy(values: Tensor) -> FloatArray:
    return np.ascontiguousarray(values.cpu().numpy())
