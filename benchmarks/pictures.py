"""The pictures of a folder, and pictures of any size made from them."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sgmethod.io.image import read_image_8_bit
from tests.support.data import PHOTOGRAPHS

SUFFIXES = {".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp"}
PHOTOGRAPH = PHOTOGRAPHS / "kodim23-crop.png"
MIRRORS = 4  # images of a picture
RATIO = 4 / 3  # of a mosaic's sides
Pixels = NDArray[np.uint8]


def pictures_in(folder: Path) -> list[Path]:
    """The folder's pictures, by name; none if it has none. Raises OSError if it cannot be read."""
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)


def chosen_from(folder: Path, most: int) -> list[Path]:
    """At most `most` of the folder's pictures, evenly spread. Raises SystemExit if there is none."""
    every = pictures_in(folder)
    if not every:
        raise SystemExit(f"there is no picture in {folder}")
    return [every[k * len(every) // most] for k in range(most)] if most < len(every) else every


def add_options(parser: argparse.ArgumentParser, most: int) -> None:
    """Add --images, --most and --pictures, which named_in() understands."""
    parser.add_argument("--images", type=Path, required=True, help="folder of pictures")
    parser.add_argument("--most", type=int, default=most, help="pictures, evenly spread over the folder")
    parser.add_argument("--pictures", type=lambda text: text.split(","), help="those of them to measure, by name; all")


def named_in(options: argparse.Namespace) -> list[Path]:
    """The pictures that such options name. Raises SystemExit if there is none."""
    chosen = chosen_from(options.images, options.most)
    names = {path.stem for path in chosen}
    if unknown := {*(options.pictures or ())} - names:
        raise SystemExit(f"{', '.join(sorted(unknown))}: no such picture; there are {', '.join(sorted(names))}")
    return [path for path in chosen if path.stem in (options.pictures or names)]


def sized(paths: Sequence[Path], first: int, megapixels: float) -> Pixels:
    """A picture [H, W, 3] of about that size: the middle of the first one, or a mosaic that begins with it where it is
    too small. A mosaic has sides of 4 to 3; its pictures lie at their own size."""
    own = read_image_8_bit(paths[first].read_bytes())
    pixels = megapixels * 1e6
    if own.shape[0] * own.shape[1] >= 0.9 * pixels:
        scale = min(math.sqrt(pixels / (own.shape[0] * own.shape[1])), 1.0)
        return middle_of(own, round(own.shape[0] * scale), round(own.shape[1] * scale))
    height = round(math.sqrt(pixels / RATIO))
    width = round(pixels / height)
    canvas = np.zeros((height, width, 3), np.uint8)
    y = number = 0
    while y < height:
        x, band = 0, height - y
        row = []
        while x < width:
            row.append(read_image_8_bit(paths[(first + number) % len(paths)].read_bytes()))
            x, number = x + row[-1].shape[1], number + 1
            band = min(band, row[-1].shape[0])
        laid = np.concatenate([middle_of(one, band, one.shape[1]) for one in row], axis=1)
        canvas[y : y + band] = laid[:, :width]
        y += band
    return canvas


def mirrored(pixels: Pixels, number: int) -> Pixels:
    """A mirror image of a picture [H, W, 3]: 0 as it is, 1 left and right exchanged, 2 top and bottom, 3 both."""
    return np.ascontiguousarray(pixels[:: -1 if number & 2 else 1, :: -1 if number & 1 else 1])


def photograph(side: int) -> Pixels:
    """The middle of a test picture, brought to size."""
    pixels = read_image_8_bit(PHOTOGRAPH.read_bytes())
    short = min(pixels.shape[:2])
    y, x = (pixels.shape[0] - short) // 2, (pixels.shape[1] - short) // 2
    shown = cv2.resize(pixels[y : y + short, x : x + short], (side, side), interpolation=cv2.INTER_AREA)
    return np.asarray(shown, np.uint8)


def middle_of(pixels: Pixels, height: int, width: int) -> Pixels:
    """The middle of a picture."""
    y, x = (pixels.shape[0] - height) // 2, (pixels.shape[1] - width) // 2
    return np.ascontiguousarray(pixels[y : y + height, x : x + width])
