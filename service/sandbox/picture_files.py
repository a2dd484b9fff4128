"""Pixels as files of the formats that browsers show, made fast: somebody waits."""

from __future__ import annotations

import io
from collections.abc import Callable
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
NEAR = 0.03  # files whose sizes differ by no more than this share count as equally large
PNG_LEVEL = 1

Pixels = NDArray[np.uint8]


def encode_picture(pixels: Pixels, kind: PictureFormat, quality: int | None = None) -> bytes:
    """The file of pixels, uint8 [H, W, 3], whose sides are at most MAX_SIDES of its kind; quality: 1 to 100."""
    options = {**OPTIONS.get(kind, {}), "quality": quality or DEFAULT_QUALITY.get(kind)}
    return pictures.encode_picture(
        pixels, pictures.SUFFIXES[f".{kind}"], options, lambda rows: isal_zlib.compress(rows, PNG_LEVEL)
    )


def as_large(encoded: Callable[[int], bytes], size: int) -> bytes:
    """Of the files of qualities 1 to 100, the finest of at most `size` bytes; the next larger if that is not near."""
    under = over = None
    low, high = 0, 101
    while high - low > 1:
        quality = (low + high) // 2
        file = encoded(quality)
        if len(file) <= size:
            under, low = file, quality
        else:
            over, high = file, quality
    if under is not None and (over is None or len(under) >= (1 - NEAR) * size):
        return under
    assert over is not None  # one of them is there
    return over


@dataclass(frozen=True)
class Rival:
    """The picture file that a bitstream of `size` bytes is compared with."""

    kind: RivalFormat
    size: int

    def made_of(self, pixels: Pixels, *, drawn: bool = False) -> bytes:
        """The file of pixels, uint8 [H, W, 3]. drawn: they are no photograph, and AVIF keeps their colours sharp."""
        return as_large(lambda quality: self._encoded(pixels, quality, drawn), self.size)

    def _encoded(self, pixels: Pixels, quality: int, drawn: bool) -> bytes:
        from PIL import Image  # not before a rival is asked for

        name, options = RIVALS[self.kind]
        if self.kind == "avif":
            height, width = pixels.shape[:2]
            speeds = (speed for most, speed in AVIF_SPEEDS if width * height <= most)
            sampling = "4:4:4" if drawn else "4:2:0"
            options = {**options, "speed": next(speeds, FASTEST_AVIF), "subsampling": sampling}
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, name, quality=quality, **options)
        return file.getvalue()
