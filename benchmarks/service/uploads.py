"""Pictures for the service to encode."""

from __future__ import annotations

import numpy as np
from PIL import Image

from tests.support.pictures import saved


def made_picture(width: int, height: int, seed: int = 0) -> bytes:
    """A PNG with noise at every scale, as in photographs, and a few edges."""
    random = np.random.default_rng(seed)
    pixels = np.zeros((height, width, 3))
    cells = 4
    while cells <= max(width, height):
        coarse = random.normal(128, 1, (max(2, cells * height // width), cells, 3)).clip(0, 255)
        layer = [Image.fromarray(coarse[..., c].astype(np.float32)).resize((width, height), 3) for c in range(3)]
        pixels += (np.stack([np.asarray(c) for c in layer], 2) - 128) * 90 / cells**0.8
        cells *= 2
    y, x = np.mgrid[0:height, 0:width]
    for _ in range(6):
        cx, cy, r = random.uniform(0, width), random.uniform(0, height), random.uniform(0.05, 0.2) * width
        pixels[np.hypot(x - cx, y - cy) < r] += random.uniform(-60, 60, 3)
    return saved(Image.fromarray((pixels + 128).clip(0, 255).astype(np.uint8)), compress_level=1)
