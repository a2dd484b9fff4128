"""Reducing a picture to what a preview can show, while reading no more of it than necessary."""

from __future__ import annotations

import os

import numpy as np
from PIL import Image

from sgmethod.errors import ImageError
from sgmethod.io.files import checked_path
from sgmethod.io.image import ImageLimits, Input, read_header, read_image_8_bit, read_input
from sgmethod.scene import Pixels

Size = tuple[int, int]  # width, height

THINNEST = 16  # pixels; a thinner strip counts as this thick, because its Gaussians are no smaller along it
SHORTEST = 3 / 4  # least shorter side tried for the best aspect ratio, as a part of the longest allowed
SPARE = 2  # a picture is first reduced cheaply to this multiple of the size, a JPEG while it is decoded


def reduced(image: Input, pixels: int, limits: ImageLimits | None = None) -> tuple[Pixels, Size]:
    """Read a picture at reduced_size(), uint8 [H, W, 3 or 4]; also return its own size as displayed.

    limits: of image files. Raises ImageError, and OSError for a path that cannot be read.
    """
    if isinstance(image, str | os.PathLike):
        image = checked_path(image, ImageError).read_bytes()
    if isinstance(image, bytes | bytearray | memoryview):
        header = read_header(bytes(image), limits)
        own = header.width, header.height
        smaller = min(side // to for side, to in zip(own, reduced_size(own, pixels), strict=True)) // SPARE
        whole = read_image_8_bit(bytes(image), limits, keep_alpha=True, smaller=smaller)
    else:
        whole = read_input(image, keep_alpha=True)
        own = whole.shape[1], whole.shape[0]
    size = reduced_size(own, pixels)
    if whole.shape[1::-1] == size:
        return whole, own
    return np.asarray(Image.fromarray(whole).resize(size, Image.Resampling.LANCZOS, reducing_gap=SPARE)), own


def reduced_size(size: Size, pixels: int) -> Size:
    """Size of about this many pixels at most, with the aspect ratio nearest to `size`.

    A strip keeps one pixel across, and is reduced along.

    >>> reduced_size((4032, 3024), 12_800), reduced_size((3872, 2592), 12_800)
    ((128, 96), (121, 81))
    """
    short, long = sorted(size)
    longest = pixels // THINNEST
    scale = min((pixels / (short * long)) ** 0.5, longest / long)
    if scale >= 1:
        return size
    max_side = max(int(scale * short), 1)
    sides = [(side, min(round(side * long / short), longest)) for side in range(max_side, int(SHORTEST * max_side), -1)]
    best = min(sides, key=lambda one: abs(one[1] / one[0] * short / long - 1))
    return best if size[0] < size[1] else best[::-1]
