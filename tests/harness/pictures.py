"""Pictures that tests make up: one that encodes at once, one that takes long, one of noise, and a page of text."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw


def saved(image: Image.Image, kind: str = "PNG", **options: Any) -> bytes:
    """A picture as a file of Pillow's."""
    file = io.BytesIO()
    image.save(file, kind, **options)
    return file.getvalue()


def pixels_of(file: bytes) -> NDArray[np.uint8]:
    """What Pillow reads from a file."""
    return np.asarray(Image.open(io.BytesIO(file)))


def png(width: int, height: int, seed: int = 0) -> bytes:
    """A picture with some structure: a gradient, a disc and a little noise."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    disc = (np.hypot(x - width / 2, y - height / 2) < min(width, height) / 4) * 90.0
    noise = np.random.default_rng(seed).normal(0, 8, (height, width, 3))
    pixels = np.stack([x / width * 160, y / height * 160, disc], axis=2) + noise + 40
    return saved(Image.fromarray(pixels.clip(0, 255).astype(np.uint8)))


def noise(side: int) -> bytes:
    """A square PNG of three bytes a pixel."""
    return saved(Image.fromarray(np.random.default_rng(1).integers(0, 256, (side, side, 3), np.uint8)))


def page_of_text() -> bytes:
    """Lines of text, black on white, 240 pixels wide and 160 high."""
    picture = Image.new("RGB", (240, 160), "white")
    for y in range(8, 150, 14):
        ImageDraw.Draw(picture).text((8, y), "Words of a page, in lines: 0123456789", "black")
    return saved(picture)


SMALL = png(64, 48)
SLOW = png(768, 768)
