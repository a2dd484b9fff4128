"""The picture that Gaussians are fitted to: its error, and the gradients by every parameter."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from sgmethod.fitting import eye
from sgmethod.fitting.bands import Rows
from sgmethod.fitting.leads import Lead
from sgmethod.fitting.parameters import Parameters
from sgmethod.native import native
from sgmethod.scene import FloatArray

Target = NDArray[np.int16]


def target_of(pixels: NDArray[np.uint8], background: tuple[int, int, int] = (0, 0, 0)) -> Target:
    """What Gaussians on a background should add up to, [3, H, W], for pixels [H, W, 3]: TARGET_WHITE is white."""
    target = np.empty((3, *pixels.shape[:2]), np.int16)
    for plane, channel, below in zip(target, pixels.transpose(2, 0, 1), background, strict=True):
        np.subtract(channel, below, out=plane, dtype=np.int16)
        plane *= native.TARGET_WHITE // 255
    return target


class Picture:
    """The target with its loss; evaluates Gaussians and their gradients natively.

    A picture of half the size serves as well while Gaussians are few, at a quarter of the time: means and factors
    stay in pixels of the whole picture, and spacing says how many of those a pixel of this one is wide.
    """

    def __init__(
        self,
        target: Target,
        lambda_g: float,
        cutoff: float,
        pyramid: bool = False,
        spacing: int = 1,
        visibility: eye.Visibility | None = None,
        shown: eye.Visibility | None = None,
        lead: Lead | None = None,
    ) -> None:
        """target: of target_of(); lambda_g weighs the geometry-consistent regularisation; cutoff: sigma at which the
        weight of a Gaussian ends, and pyramid: whether it is drawn in one, by the version of the format; visibility
        [H, W]: then gradients, residuals and colours are those of the error as it is seen (eye.py); shown: what alone
        weighs error(), where the picture can be seen through; lead: what follow() moves the target by."""
        self.target, self.visibility, self.shown, self.lead = target, visibility, shown, lead
        self.height, self.width = target.shape[1:]
        self.values = target.size
        self.spacing = spacing
        self.lambda_g = lambda_g
        self.cutoff, self.pyramid = cutoff, pyramid
        if lambda_g > 0:
            self._loss = native.ReconstructionLoss(self.rows(0, self.height), lambda_g)
            self._image, self._grad = np.empty(target.shape, np.float32), np.empty(target.shape, np.float32)

    def rows(self, first: int, end: int) -> FloatArray:
        """The target's rows from first to before end, in which 1 is white."""
        rows = self.target[:, first:end].astype(np.float32)
        rows /= native.TARGET_WHITE
        return rows

    def halved(self) -> Picture:
        """The same picture at half the size."""
        even: NDArray[np.int16] = self.target
        if self.height % 2 or self.width % 2:
            even = np.pad(even, ((0, 0), (0, self.height % 2), (0, self.width % 2)), mode="edge")
        sums = np.add(even[:, 0::2, 0::2], even[:, 1::2, 0::2], dtype=np.int32)
        sums += even[:, 0::2, 1::2]
        sums += even[:, 1::2, 1::2]
        sums += 2
        sums >>= 2
        visibility = None if self.visibility is None else self.visibility.halved()
        half = sums.astype(np.int16)
        return Picture(half, self.lambda_g, self.cutoff, self.pyramid, 2 * self.spacing, visibility)

    def rasterise(self, means: Tensor, factors: Tensor) -> native.Rasterization:
        """The geometry over this picture's pixels."""
        arrays = self._scaled(means, factors)
        return native.Rasterization(*arrays, self.width, self.height, self.cutoff, pyramid=self.pyramid)

    def _scaled(self, means: Tensor, factors: Tensor) -> tuple[FloatArray, FloatArray]:
        """In this picture's pixels."""
        if self.spacing != 1:
            means, factors = means / self.spacing, factors / self.spacing
        return means.contiguous().numpy(), factors.contiguous().numpy()

    def gradients(self, p: Parameters) -> tuple[float, Parameters]:
        """Mean squared error, and the gradients of MSE + lambda_g L_g by each parameter."""
        if self.lambda_g == 0:
            mse, out = self._squared_error(p)
        else:
            raster, colors, out = self.rasterise(p.means, p.factors), p.colors.contiguous().numpy(), p.alike()
            raster.render(colors, self._image)
            mse, _ = self._loss(self._image, self._grad)
            raster.backward(colors, self._grad, *out.arrays())
        if self.spacing != 1:
            out.means /= self.spacing
            out.factors /= self.spacing
        return mse, out

    def error(self, p: Parameters) -> float:
        """Mean squared error."""
        raster, colors = self.rasterise(p.means, p.factors), p.colors.contiguous().numpy()
        if self.shown is None:
            return raster.error(colors, self._unmoved())
        gradients = p.alike().arrays()  # which nobody reads
        return raster.squared_error(colors, self._unmoved(), *gradients, self.shown.values, self.shown.by_eye)

    def follow(self, p: Parameters) -> None:
        """Move the target, where something leads it."""
        if self.lead is not None:
            self.lead.follow(self.left(p))
            self.target = self.lead.target

    def left(self, p: Parameters) -> Rows:
        """All of the unmoved target, less the picture, as residual() gives it."""
        return self._missing(p, self._unmoved())

    def _unmoved(self) -> Target:
        return self.target if self.lead is None else self.lead.unmoved

    def _squared_error(self, p: Parameters) -> tuple[float, Parameters]:
        """The mean, and its gradients in this picture's pixels."""
        out = p.alike()
        colors = p.colors.contiguous().numpy()
        raster = self.rasterise(p.means, p.factors)
        seen = () if self.visibility is None else (self.visibility.values, self.visibility.by_eye)
        return raster.squared_error(colors, self.target, *out.arrays(), *seen), out

    def residual(self, p: Parameters) -> Rows:
        """Target minus picture, in this picture's pixels, as far as it is seen. It is drawn when it is asked for rows:
        from the first to before another, [3, rows, W]."""
        visibility, missing = self.visibility, self._missing(p, self.target)
        if visibility is None:
            return missing
        return lambda first, end: eye.amplitudes(visibility, missing(first, end), first, end)

    def _missing(self, p: Parameters, target: Target) -> Rows:
        """What residual() gives, all of it, of a target."""
        arrays, colors = self._scaled(p.means, p.factors), p.colors.contiguous().numpy()

        def rows(first: int, end: int) -> FloatArray:
            missing = np.empty((3, end - first, self.width), np.float32)
            size = (self.width, end - first)
            raster = native.Rasterization(*arrays, *size, cutoff=self.cutoff, pyramid=self.pyramid, y=first)
            raster.missing(colors, np.ascontiguousarray(target[:, first:end]), missing)
            return missing

        return rows

    def solve_colors(
        self, means: Tensor, factors: Tensor, steps: int, others: Parameters | None = None, damping: float = 1e-2
    ) -> Tensor:
        """Colours [N, 3] near the least-squares solution for fixed geometry: the image is linear in them.

        Conjugate gradients from zero on the normal equations, preconditioned by the Gaussians' energies
        pi l1 l3, of which `damping` is added to the diagonal. The target is the picture, less others.
        """
        n = len(means)
        energy = (math.pi / self.spacing**2 * factors[:, :1] * factors[:, 2:]).clamp_min(1e-12)
        black = Parameters(means, factors, torch.zeros(n, 3))
        _, gradients = self._squared_error(black if others is None else others.with_more(black))
        residual = gradients.colors[-n:] * (-self.values / 2)  # each one's product with what is missing
        if self.visibility is not None:  # gram() and the colours that solve it know nothing of how colours count
            residual = residual @ torch.tensor(np.linalg.inv(self.visibility.color), dtype=torch.float32)
        raster = self.rasterise(means, factors)
        colors, product = torch.zeros(n, 3), torch.empty(n, 3)
        direction = z = residual / energy
        rz = (residual * z).sum(0)
        for _ in range(steps):
            raster.gram(direction.numpy(), product.numpy(), None if self.visibility is None else self.visibility.values)
            q = product + damping * energy * direction
            alpha = rz / (direction * q).sum(0).clamp_min(1e-30)
            colors = colors + alpha * direction
            residual = residual - alpha * q
            z = residual / energy
            rz, previous = (residual * z).sum(0), rz
            direction = z + rz / previous.clamp_min(1e-30) * direction
        return colors
