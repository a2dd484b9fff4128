"""Gaussians as tensors, on every device of torch; importing this imports torch.

    image = sgmethod.torch.render(means, factors, colors, (width, height))  # [3, height, width], with gradients
    pixels = sgmethod.torch.decode("photo.sg", "cuda")
    found = sgmethod.torch.fit(images, 500)  # images [B, 3, H, W], found.means [B, 500, 2] and so on

drawing.py has the renderer, reading.py .sg files as tensors, fitting.py fits of batches, shards.py fitted data
sets, gaussian_image.py parameters of GaussianImage.

A fit (exact.py) runs the steps of sgmethod.rd on a Backend: the compiled kernels on
the CPU, batched.py for many pictures at once on a GPU with Triton, tensors.py on other devices. Gaussians are drawn by
tiles.py, which launches tile_kernels.py, or by the operations on tensors in pairs.py.
"""

from __future__ import annotations

from sgmethod.errors import extra

with extra("torch"):
    from sgmethod.torch.drawing import render
    from sgmethod.torch.fitting import Fit, fit
    from sgmethod.torch.gaussian_image import from_gaussian_image
    from sgmethod.torch.reading import SgDataset, decode, draw, gaussians
    from sgmethod.torch.shards import fit_many

__all__ = ["Fit", "SgDataset", "decode", "draw", "fit", "fit_many", "from_gaussian_image", "gaussians", "render"]
