"""Fit Gaussians to a photograph, then continue training with another loss: python fit_in_torch.py PHOTO OUT.sg

Needs pip install -e '.[torch]' in a checkout. fit() minimises the squared error. The steps after it minimise the
absolute error with one of PyTorch's optimisers; any other loss works the same way.
"""

import sys
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageOps

import sgmethod
from sgmethod.torch import fit, render

GAUSSIANS, STEPS = 1000, 50


def fit_photo(path: str, out: str) -> None:
    """Write an .sg file of a photograph of at most 256 x 256 pixels."""
    with Image.open(path) as photo:
        small = ImageOps.exif_transpose(photo).convert("RGB")
    small.thumbnail((256, 256))
    image = torch.from_numpy(np.array(small)).permute(2, 0, 1)[None]  # uint8 [1, 3, height, width]
    found = fit(image, GAUSSIANS)
    print(f"squared error: {-10 * torch.log10(found.error[0]):.2f} dB")

    target, size = image[0] / 255, small.size
    means, factors, colors = (values[0].requires_grad_() for values in found[:3])
    rates = zip((means, factors, colors), (0.01, 0.01, 0.001), strict=True)
    optimiser = torch.optim.Adam([{"params": values, "lr": rate} for values, rate in rates])
    for step in range(STEPS):
        # pyramid=True draws as the file will be drawn.
        picture = render(means, factors, colors, size, found.background[0], pyramid=True)
        loss = (picture - target).abs().mean()
        if step % 10 == 0:
            print(f"step {step}: absolute error {loss.item():.5f}")
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        with torch.no_grad():
            factors[:, ::2].clamp_(min=0.2)  # l1 and l3 stay positive
    gaussians = sgmethod.Gaussians(means, factors, colors)
    data = sgmethod.pack(gaussians, *size, bpp=2, background=found.background[0], image=small)
    Path(out).write_bytes(data)
    print(f"{out}: {len(data):,} bytes")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python fit_in_torch.py PHOTO OUT.sg")
    fit_photo(*sys.argv[1:])
