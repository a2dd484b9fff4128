"""Pixels as files of the formats that browsers show."""

from __future__ import annotations

import io
from typing import Literal

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray
from PIL import Image

from sgmethod.io.png import encode_png

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

WEBP_METHOD, AVIF_SPEED = 0, 9  # somebody waits
PNG_LEVEL = 1

Pixels = NDArray[np.uint8]


def encode_picture(pixels: Pixels, kind: PictureFormat, quality: int | None = None) -> bytes:
    """The file of pixels, uint8 [H, W, 3], whose sides are at most MAX_SIDES of its kind; quality: 1 to 100."""
    if kind == "png":
        return encode_png(pixels, lambda rows: isal_zlib.compress(rows, PNG_LEVEL))
    options = {"jpg": {}, "webp": {"method": WEBP_METHOD}, "avif": {"speed": AVIF_SPEED, "max_threads": 1}}[kind]
    file = io.BytesIO()
    format_ = MEDIA_TYPES[kind].removeprefix("image/").upper()
    Image.fromarray(pixels).save(file, format_, quality=quality or DEFAULT_QUALITY[kind], **options)
    return file.getvalue()
