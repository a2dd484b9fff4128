"""Backgrounds, and bytes that a picture cannot use: small pictures that few encoders expect."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sgmethod import decode, encode
from sgmethod.fitting.level import Histogram
from sgmethod.metrics import psnr
from sgmethod.scene import Pixels

LOT = np.random.default_rng(0)


def board(height: int, width: int, whiter: int = 0) -> Pixels:
    """A checkerboard, with some of its black pixels white."""
    level = (np.indices((height, width)).sum(0) % 2 * 255).astype(np.uint8)
    level[tuple(np.argwhere(level == 0)[: 7 * whiter : 7].T)] = 255
    return np.repeat(level[..., None], 3, 2)


def page() -> Pixels:
    """A word's worth of black on white."""
    pixels = np.full((48, 64, 3), 255, np.uint8)
    pixels[20:30, 10:14] = pixels[20:24, 10:30] = 0
    return pixels


NOISE = np.repeat((LOT.random((64, 64, 1)) < 0.52).astype(np.uint8) * 255, 3, 2)
ODD = {
    "checkerboard": board(64, 64),
    "checkerboard and two": board(64, 64, 2),
    "noise": NOISE,
    "line of 5": LOT.integers(0, 256, (1, 5, 3), np.uint8),
    "7 x 9": LOT.integers(0, 256, (7, 9, 3), np.uint8),
    "page": page(),
}


def reached(pixels: Pixels, size: int) -> float:
    """PSNR of a file of at most `size` bytes, at most 60 dB."""
    return min(psnr(decode(encode(pixels, bytes=size, tune="psnr").data), pixels), 60.0)


@pytest.mark.parametrize("name", ODD)
def test_a_few_bytes_are_no_worse_than_one_grey(name: str) -> None:
    """White, of 50.05 %, was the background, and 3.01 dB in the bytes in which grey has 6.02."""
    pixels = ODD[name]
    mean = np.broadcast_to(np.rint(pixels.mean((0, 1))).astype(np.uint8), pixels.shape)
    slack = 0.3 if len({*pixels.mean((0, 1))}) > 1 else 0.02  # dB: a short file rounds its background
    assert reached(pixels, 12) >= psnr(np.ascontiguousarray(mean), pixels) - slack


@pytest.mark.parametrize(("name", "has_majority"), [("page", True), ("checkerboard and two", False), ("noise", False)])
def test_a_background_is_near_its_picture(name: str, has_majority: bool) -> None:
    histogram = Histogram(ODD[name])
    assert histogram.has_majority == has_majority
    assert histogram.background[0] == (255 if has_majority else round(float(ODD[name][..., 0].mean())))


def test_bytes_beyond_what_a_picture_can_use_change_nothing() -> None:
    """From 1,025 bytes on, the file was not short, and came out otherwise."""
    pixels = ODD["line of 5"]
    assert encode(pixels, bytes=1500).data == encode(pixels, bytes=100).data
    assert math.isfinite(reached(pixels, 100))
