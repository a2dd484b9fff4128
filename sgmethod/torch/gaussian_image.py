"""Parameters of GaussianImage (X. Zhang et al., 2024) as Gaussians of this package."""

from __future__ import annotations

import torch
from torch import Tensor

from sgmethod.arguments import AnyInt
from sgmethod.errors import GaussiansError
from sgmethod.native import native
from sgmethod.torch.drawing import checked_size
from sgmethod.view import NO_CUTOFF, recut_factors

BOUND = (0.5, 0.0, 0.5)  # that GaussianImage adds to l1, l2 and l3


def from_gaussian_image(
    xyz: Tensor, cholesky: Tensor, features: Tensor, size: tuple[AnyInt, AnyInt]
) -> tuple[Tensor, Tensor, Tensor]:
    """Convert the parameters of a GaussianImage_Cholesky to means, factors and colours for render().

    >>> state = torch.load("gaussian_model.pth.tar")
    >>> gaussians = from_gaussian_image(state["_xyz"], state["_cholesky"], state["_features_dc"], (768, 512))

    xyz [N, 2]: means before tanh, which takes them to [-1, 1]; cholesky [N, 3]: l1, l2, l3 in pixels without the bound
    of 0.5, 0, 0.5; features [N, 3]: colours; size: width and height of the picture in pixels.

    GaussianImage's pixel centres lie at whole numbers, so half a pixel is added. render() ends Gaussians sooner, so
    each becomes the closest one with the same integral: 1.108 times as wide, its colour times 1.017. Raises
    GaussiansError for other shapes or types, and ViewError for sizes that no picture has.
    """
    lasts = ((xyz, 2), (cholesky, 3), (features, 3))
    for values, _ in lasts:
        if not isinstance(values, Tensor):
            raise GaussiansError(f"parameters must be tensors, not {type(values).__name__}")
    if any(values.ndim != 2 or values.shape != (len(xyz), last) for values, last in lasts):
        shapes = ", ".join(str(list(values.shape)) for values, _ in lasts)
        raise GaussiansError(f"parameters must have the shapes [N, 2], [N, 3] and [N, 3], got {shapes}")
    half = torch.tensor(checked_size(size), dtype=xyz.dtype, device=xyz.device) / 2
    l1, l2, l3 = (cholesky + torch.tensor(BOUND, dtype=cholesky.dtype, device=cholesky.device)).unbind(1)
    # A negative l1 or l3 makes the same covariance as a positive one.
    factors = torch.stack([l1.abs(), torch.where(l1 < 0, -l2, l2), l3.abs()], 1)
    wider, gain = recut_factors(NO_CUTOFF, native.CUTOFF_V2)
    return half * (torch.tanh(xyz) + 1) + 0.5, wider * factors, gain * features
