"""Pictures that can be seen through, as they look on a background."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8]
BLACK, WHITE = 0, 255


def laid_over(pixels: Pixels, level: int) -> Pixels:
    """Pixels [H, W, 4] on a background of one grey level: [H, W, 3], level * alpha + background * (1 - alpha)."""
    out = np.empty((*pixels.shape[:2], 3), np.uint8)
    for to, row in zip(out, pixels, strict=True):
        share = row[:, 3:].astype(np.float32) / 255
        to[...] = np.rint(row[:, :3] * share + level * (1 - share))
    return out


def on_backgrounds(pixels: Pixels) -> Pixels:
    """[1, H, W, 3] of an opaque picture; [2, H, W, 3], on black and on white, of one with alpha, of which
    two are compared on both."""
    if pixels.shape[2] == 3:
        return pixels[None]
    return np.stack([laid_over(pixels, BLACK), laid_over(pixels, WHITE)])
