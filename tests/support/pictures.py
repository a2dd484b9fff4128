"""The tests' photographs, and pictures made up: one that encodes at once, one that takes long, one of text."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from tests.support.data import PHOTOGRAPHS

FloatArray = NDArray[np.float32]
CROPS = "kodim04-crop", "kodim05-crop", "kodim23-crop"


def photo(name: str = "kodim23-crop") -> NDArray[np.uint8]:
    """A photograph [H, W, 3] of 128 x 96 pixels; kodim04-crop is as high as that is wide."""
    with Image.open(PHOTOGRAPHS / f"{name}.png") as picture:
        return np.array(picture.convert("RGB"))


def mirrored(picture: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    """A picture [H, W, 3] and its mirror images, over which the mean of what chance changes is taken."""
    return [np.ascontiguousarray(picture[::y, ::x]) for y in (1, -1) for x in (1, -1)]


def grey(values: object) -> FloatArray:
    """The picture [H, W, 3] of values [H, W] from 0 to 1."""
    return np.repeat(np.asarray(values, np.float32)[..., None], 3, axis=2)


def noise(height: int, width: int) -> FloatArray:
    return np.random.default_rng(0).random((height, width, 3)).astype(np.float32)


WAVE = np.sin(np.arange(4096) / 40) / 2 + 0.5
ODD = {
    "1 x 1": np.full((1, 1, 3), (0.9, 0.1, 0.4), np.float32),
    "white, 1 x 1": grey([[1]]),
    "2 x 1": np.array([[[0, 0.5, 1], [1, 0.5, 0]]], np.float32),
    "2 x 2": grey([[0, 1], [1, 0.5]]),
    "row": grey(WAVE[None]),
    "column": grey(WAVE[:, None]),
    "noisy row": noise(1, 300),
    "black": grey(np.zeros((40, 30))),
    "grey": grey(np.full((40, 30), 0.5)),
    "white": grey(np.ones((40, 30))),
    "noise": noise(40, 30),
    "checkerboard": grey(np.indices((40, 30)).sum(0) % 2),
    "one bright pixel": grey(np.pad([[1]], 20)),
}


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


def noisy_png(side: int) -> bytes:
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
