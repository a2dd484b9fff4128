"""Reading any kind of input: paths, files in memory, Pillow images, arrays."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from sgmethod.errors import ImageError
from sgmethod.io.files import checked_path
from sgmethod.io.header import (
    ImageLimits,
    Opened,
    check_mode,
    colour_of,
    frame_of,
    only_image_errors,
    orientation_of,
    warn,
)
from sgmethod.io.image import read_image_8_bit, upright_samples, without_alpha
from sgmethod.io.levels import Samples
from sgmethod.scene import Pixels

Input = str | os.PathLike[str] | bytes | bytearray | memoryview | Image.Image | npt.NDArray[Any]


def read_input(image: Input, *, keep_alpha: bool = False) -> Pixels:
    """Read an input as uint8 [H, W, 3], sRGB, C-contiguous.

    image: the path or bytes of an image file (rules: sgmethod/io/image.py), a Pillow image, or an array as in
    from_array(); keep_alpha: return [H, W, 4] for a transparent picture instead of compositing it over white.
    Warns with ImageWarning of anything dropped. Raises ImageError, and OSError for a path that cannot be read.
    """
    if isinstance(image, np.ndarray):
        return from_array(image, keep_alpha)
    if isinstance(image, Image.Image):
        return from_pillow(image, keep_alpha)
    if isinstance(image, bytes | bytearray | memoryview):
        return read_image_8_bit(bytes(image), keep_alpha=keep_alpha)
    if isinstance(image, str | os.PathLike):
        return read_image_8_bit(checked_path(image, ImageError).read_bytes(), keep_alpha=keep_alpha)
    raise ImageError(
        "an image must be a path, the bytes of an image file, a Pillow image or a numpy array, "
        f"not {type(image).__name__}"
    )


def from_pillow(image: Image.Image, keep_alpha: bool = False) -> Pixels:
    """Convert a Pillow image by the same rules: upright, in sRGB."""
    with only_image_errors():
        ImageLimits().check(*image.size)
        check_mode(image)
        frame, tags, image = frame_of(image), getattr(image, "tag_v2", None), image.copy()
        if tags is not None:  # a copy has lost those of TIFF, which say what white is
            image.tag_v2 = tags  # type: ignore[attr-defined]
        orientation = orientation_of(image.info.get("exif"))
        stated, notes = colour_of(image, None)
        samples = upright_samples(Opened(image, orientation, stated, notes, frame), None, keep_alpha)
    warn(notes)
    return samples.in_8_bits()


def check_range(least: float, most: float) -> None:
    """Raise ImageError unless the least and the greatest value of an image lie in [0, 1]."""
    if not least <= most:  # a minimum is NaN if any value is
        raise ImageError("image values must lie in [0, 1], got NaN")
    if least < 0 or most > 1:
        raise ImageError(f"image values must lie in [0, 1], got {least:.8g} to {most:.8g}: rescale or clip them")


def from_array(pixels: npt.NDArray[Any], keep_alpha: bool = False) -> Pixels:
    """Convert an array: grey [H, W] or [H, W, 1], RGB [H, W, 3] or RGBA [H, W, 4].

    pixels: levels in uint8 or uint16, or floating-point values in [0, 1].
    Raises ImageError for another type or shape, other values, or a size beyond ImageLimits.
    """
    pixels = np.asarray(pixels)  # np.matrix would not become three-dimensional
    pixels = pixels.astype(pixels.dtype.newbyteorder("="), copy=False)
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.ndim != 3 or pixels.shape[2] not in (1, 3, 4) or 0 in pixels.shape:
        raise ImageError(f"an image must be [H, W], or [H, W, C] with 1, 3 or 4 channels, got {list(pixels.shape)}")
    ImageLimits().check(pixels.shape[1], pixels.shape[0])
    if pixels.dtype not in (np.uint8, np.uint16):
        if not np.issubdtype(pixels.dtype, np.floating):
            raise ImageError(f"an image must be uint8, uint16 or floating-point values in [0, 1], got {pixels.dtype}")
        check_range(float(pixels.min()), float(pixels.max()))
    white = int(np.iinfo(pixels.dtype).max) if pixels.dtype.kind == "u" else 1
    notes: list[str] = []
    samples = Samples(pixels, white)
    if pixels.shape[2] == 4:
        levels, alpha = pixels[..., :3], pixels[..., 3:]
        samples = Samples(levels, white, None if alpha.min() == white else alpha, white)
    if not keep_alpha:
        samples = without_alpha(samples, notes)
    warn(notes)
    return samples.in_8_bits()
