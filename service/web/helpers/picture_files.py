"""Pixels as files of the formats that browsers show, made fast: somebody waits."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from sgmethod.io import pictures

PictureFormat = Literal["png", "jpg", "webp", "avif"]
MEDIA_TYPES: dict[PictureFormat, str] = {
    "png": "image/png",
    "jpg": "image/jpeg",
    "webp": "image/webp",
    "avif": "image/avif",
}
# Pixels of the longer side that a format can hold, or its library writes.
MAX_SIDES: dict[PictureFormat, int] = {"png": 2**31 - 1, "jpg": 65_535, "webp": 16_383, "avif": 16_384}
DEFAULT_QUALITY: dict[PictureFormat, int] = {"jpg": 90, "webp": 85, "avif": 75}
OPTIONS: dict[PictureFormat, dict[str, Any]] = {"webp": {"method": 0}, "avif": {"speed": 9, "max_threads": 1}}
PNG_LEVEL = 1

Pixels = NDArray[np.uint8]


def encode_picture(pixels: Pixels, kind: PictureFormat, quality: int | None = None) -> bytes:
    """The file of pixels, uint8 [H, W, 3], whose sides are at most MAX_SIDES of its kind; quality: 1 to 100."""
    options = {**OPTIONS.get(kind, {}), "quality": quality or DEFAULT_QUALITY.get(kind)}
    return pictures.encode_picture(
        pixels, pictures.SUFFIXES[f".{kind}"], options, lambda rows: isal_zlib.compress(rows, PNG_LEVEL)
    )
