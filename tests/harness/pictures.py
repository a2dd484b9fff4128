"""The tests' photographs, and pictures made up: one that encodes at once, one that takes long, one of text."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from tests.harness.data import PHOTOGRAPHS


def photo(name: str = "kodim23-crop") -> NDArray[np.uint8]:
    """A photograph [H, W, 3] of 128 x 96 pixels; kodim04-crop is as high as that is wide."""
    with Image.open(PHOTOGRAPHS / f"{name}.png") as picture:
        return np.array(picture.convert("RGB"))


def png(width: int, height: int, seed: int = 0) -> bytes:
    """A picture with some structure: a gradient, a disc and a little noise."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    disc = (np.hypot(x - width / 2, y - height / 2) < min(width, height) / 4) * 90.0
    noise = np.random.default_rng(seed).normal(0, 8, (height, width, 3))
    pixels = np.stack([x / width * 160, y / height * 160, disc], axis=2) + noise + 40
    file = io.BytesIO()
    Image.fromarray(pixels.clip(0, 255).astype(np.uint8)).save(file, "PNG")
    return file.getvalue()


def page_of_text() -> bytes:
    """Lines of text, black on white, 240 pixels wide and 160 high."""
    picture = Image.new("RGB", (240, 160), "white")
    for y in range(8, 150, 14):
        ImageDraw.Draw(picture).text((8, y), "Words of a page, in lines: 0123456789", "black")
    file = io.BytesIO()
    picture.save(file, "PNG")
    return file.getvalue()


SMALL = png(64, 48)
SLOW = png(768, 768)
