"""The picture that Gaussians are fitted to: its error, and the gradients by every parameter."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from sgmethod.fitting.parameters import Parameters
from sgmethod.native import native
from sgmethod.scene import FloatArray


class Picture:
    """The target with its loss; evaluates Gaussians and their gradients natively.

    A picture of half the size serves as well while Gaussians are few, at a quarter of the time: means and factors
    stay in pixels of the whole picture, and spacing says how many of those a pixel of this one is wide.
    """

    def __init__(
        self, image: FloatArray, lambda_g: float, cutoff: float, pyramid: bool = False, spacing: int = 1
    ) -> None:
        """image [H, W, 3] in [0, 1]; lambda_g weighs the geometry-consistent regularisation; cutoff: sigma at
        which the weight of a Gaussian ends, and pyramid: whether it is drawn in one, by the version of the format."""
        self.target = torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))
        self.height, self.width = image.shape[:2]
        self.spacing = spacing
        self.lambda_g = lambda_g
        self.cutoff, self.pyramid = cutoff, pyramid
        self._loss = native.ReconstructionLoss(self.target.numpy(), lambda_g)
        self._image = torch.empty_like(self.target)
        self._grad = torch.empty_like(self.target)

    def halved(self) -> Picture:
        """The same picture at half the size."""
        planes = torch.nn.functional.pad(self.target[None], (0, self.width % 2, 0, self.height % 2), mode="replicate")
        small = torch.nn.functional.avg_pool2d(planes, 2)[0].permute(1, 2, 0).numpy()
        picture = Picture(small, self.lambda_g, self.cutoff, self.pyramid, 2 * self.spacing)
        # Scratch is shared: pictures are evaluated one at a time.
        picture._image, picture._grad = (
            whole.view(-1)[: picture.target.numel()].view_as(picture.target) for whole in (self._image, self._grad)
        )
        return picture

    def rasterise(self, means: Tensor, factors: Tensor) -> native.Rasterization:
        """The geometry over this picture's pixels."""
        if self.spacing != 1:
            means, factors = means / self.spacing, factors / self.spacing
        arrays = means.contiguous().numpy(), factors.contiguous().numpy()
        return native.Rasterization(*arrays, self.width, self.height, self.cutoff, pyramid=self.pyramid)

    def gradients(self, p: Parameters) -> tuple[float, Parameters]:
        """Mean squared error, and the gradients of MSE + lambda_g L_g by each parameter."""
        raster = self.rasterise(p.means, p.factors)
        colors = p.colors.contiguous().numpy()
        out = Parameters.empty(len(p.means))
        if self.lambda_g == 0:
            mse = raster.squared_error(colors, self.target.numpy(), *out.arrays())
        else:
            image, grad = self._image.numpy(), self._grad.numpy()
            raster.render(colors, image)
            mse, _ = self._loss(image, grad)
            raster.backward(colors, grad, *out.arrays())
        if self.spacing != 1:
            out.means /= self.spacing
            out.factors /= self.spacing
        return mse, out

    def residual(self, p: Parameters) -> Tensor:
        """Target minus picture [3, H, W], in this picture's pixels; valid until gradients() is called."""
        self.rasterise(p.means, p.factors).render(p.colors.contiguous().numpy(), self._grad.numpy())
        return torch.sub(self.target, self._grad, out=self._grad)

    def interleaved(self, planes: Tensor) -> FloatArray:
        """Planes [3, H, W] of this picture's size as [H, W, 3], in memory of this picture: valid until it is drawn."""
        return self._image.view(self.height, self.width, 3).copy_(planes.permute(1, 2, 0)).numpy()

    def solve_colors(
        self, means: Tensor, factors: Tensor, steps: int, residual_of: Tensor | None = None, damping: float = 1e-2
    ) -> Tensor:
        """Colours [N, 3] near the least-squares solution for fixed geometry: the image is linear in them.

        Conjugate gradients from zero on the normal equations, preconditioned by the Gaussians' energies
        pi l1 l3, of which `damping` is added to the diagonal. The target is the picture, or residual_of [3, H, W].
        """
        raster, n = self.rasterise(means, factors), len(means)
        energy = (math.pi / self.spacing**2 * factors[:, :1] * factors[:, 2:]).clamp_min(1e-12)
        zero = np.zeros((n, 3), np.float32)
        by_means, by_factors, _ = Parameters.empty(n).arrays()

        def transpose(image: Tensor) -> Tensor:
            out = torch.empty(n, 3)
            raster.backward(zero, image.numpy(), by_means, by_factors, out.numpy())
            return out

        colors = torch.zeros(n, 3)
        residual = transpose(self.target if residual_of is None else residual_of)
        direction = z = residual / energy
        rz = (residual * z).sum(0)
        for _ in range(steps):
            raster.render(direction.numpy(), self._image.numpy())
            q = transpose(self._image) + damping * energy * direction
            alpha = rz / (direction * q).sum(0).clamp_min(1e-30)
            colors = colors + alpha * direction
            residual = residual - alpha * q
            z = residual / energy
            rz, previous = (residual * z).sum(0), rz
            direction = z + rz / previous.clamp_min(1e-30) * direction
        return colors
