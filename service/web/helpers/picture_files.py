"""Pixels as files of the formats that browsers show, made fast: somebody waits."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from sgmethod.io import pictures

PictureFormat = Literal["png", "jpg", "webp", "avif"]
RivalFormat = Literal["jpg", "webp", "avif"]
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
# Of rivals: without a profile, which would be a tenth of a small file.
RIVALS: dict[RivalFormat, tuple[str, dict[str, Any]]] = {
    "jpg": ("JPEG", {"optimize": True}),
    "webp": ("WEBP", {"method": 4}),
    "avif": ("AVIF", {"max_threads": 1}),
}
# A search takes seven files: at these speeds 3.3, 0.9 or 0.2 s of a core for 0.37 megapixels. The last loses 0.6 dB.
AVIF_SPEEDS = ((600_000, 6), (3_000_000, 8))
FASTEST_AVIF = 9
PNG_LEVEL = 1

Pixels = NDArray[np.uint8]


def encode_picture(pixels: Pixels, kind: PictureFormat, quality: int | None = None) -> bytes:
    """The file of pixels, uint8 [H, W, 3], whose sides are at most MAX_SIDES of its kind; quality: 1 to 100."""
    options = {**OPTIONS.get(kind, {}), "quality": quality or DEFAULT_QUALITY.get(kind)}
    return pictures.encode_picture(
        pixels, pictures.SUFFIXES[f".{kind}"], options, lambda rows: isal_zlib.compress(rows, PNG_LEVEL)
    )


@dataclass(frozen=True)
class Rival:
    """The picture file that a bitstream is compared with: the finest of its kind of at most max_bytes."""

    kind: RivalFormat
    max_bytes: int

    def made_of(self, pixels: Pixels) -> bytes:
        """The file of pixels, uint8 [H, W, 3]; if none is as small, the smallest."""
        best, low, high = self._encoded(pixels, 1), 1, 101
        while high - low > 1 and len(best) <= self.max_bytes:
            quality = (low + high) // 2
            file = self._encoded(pixels, quality)
            if len(file) <= self.max_bytes:
                best, low = file, quality
            else:
                high = quality
        return best

    def _encoded(self, pixels: Pixels, quality: int) -> bytes:
        from PIL import Image  # not before a rival is asked for

        name, options = RIVALS[self.kind]
        if self.kind == "avif":
            height, width = pixels.shape[:2]
            speeds = (speed for most, speed in AVIF_SPEEDS if width * height <= most)
            options = {**options, "speed": next(speeds, FASTEST_AVIF)}
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, name, quality=quality, **options)
        return file.getvalue()
