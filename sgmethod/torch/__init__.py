"""Gaussians as tensors, on every device of torch; importing this imports torch.

    image = sgmethod.torch.render(means, factors, colors, (width, height))  # [3, height, width], with gradients
    pixels = sgmethod.torch.decode("photo.sg", "cuda")

Tensors come in, and tensors leave, with gradients; files come in, and leave as tensors or as Gaussians. drawing.py has
the renderer, files.py .sg files as tensors.
"""

from __future__ import annotations

from sgmethod.errors import extra

with extra("torch"):
    from sgmethod.torch.drawing import render
    from sgmethod.torch.files import SgDataset, decode, draw, gaussians

__all__ = ["SgDataset", "decode", "draw", "gaussians", "render"]
