"""Transparent pictures composited over a background."""

from __future__ import annotations

import numpy as np

from sgmethod.scene import Pixels

BLACK, WHITE = 0, 255


def composited(pixels: Pixels, level: int) -> Pixels:
    """Composite pixels [H, W, 4] over one grey level: [H, W, 3], value * alpha + level * (1 - alpha)."""
    out = np.empty((*pixels.shape[:2], 3), np.uint8)
    for to, row in zip(out, pixels, strict=True):
        share = row[:, 3:].astype(np.float32) / 255
        to[...] = np.rint(row[:, :3] * share + level * (1 - share))
    return out


def on_backgrounds(pixels: Pixels) -> Pixels:
    """Pictures to compare: [1, H, W, 3] if opaque, else [2, H, W, 3], composited over black and over white."""
    if pixels.shape[2] == 3:
        return pixels[None]
    return np.stack([composited(pixels, BLACK), composited(pixels, WHITE)])
