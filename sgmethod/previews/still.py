"""A picture as the best small WebP for a page without scripts."""

from __future__ import annotations

import base64
import io
import math

import numpy as np
from PIL import Image

from sgmethod.io.within import largest_within
from sgmethod.metrics import psnr
from sgmethod.scene import Pixels

SIDES = (8, 12, 16, 24, 32, 48, 64)  # pixels of the longer one: a browser enlarges them smoothly
JUDGED_SIDE = 192  # pixels of the longer side at which files are compared
PREFIX = "data:image/webp;base64,"


def webp_uri(pixels: Pixels, characters: int) -> str:
    """Find the WebP with the highest PSNR whose data URI has at most so many characters; "" if none has.

    pixels: uint8 [H, W, 3], reduced to several sizes, each at the best quality that fits, and compared enlarged
    bicubically. AVIF has no file as small, and neither PNG nor CSS gradients are as good (docs/notebook/service.md).
    """
    picture = Image.fromarray(pixels)
    judged = _reduced(picture, JUDGED_SIDE)
    max_bytes = max(characters - len(PREFIX), 0) // 4 * 3
    best, best_db = b"", 0.0
    for side in SIDES:
        webp = _best_quality(_reduced(picture, side), max_bytes)
        if webp:
            drawn = Image.open(io.BytesIO(webp)).convert("RGB").resize(judged.size, Image.Resampling.BICUBIC)
            db = psnr(np.asarray(drawn), np.asarray(judged))
            best, best_db = max((best, best_db), (webp, db), key=lambda one: one[1])
    return PREFIX + base64.b64encode(best).decode() if best else ""


def _reduced(picture: Image.Image, side: int) -> Image.Image:
    """Reduce a picture to a longer side of about that length.

    Of the lengths close by, take the one whose aspect ratio is closest to the picture's: contained in the photograph's
    box, the WebP would leave a strip of the page beside it.
    """
    longer = max(picture.size)
    sizes = []
    for length in range(side - side // 8, side + side // 8 + 1):
        width, height = (max(round(min(length / longer, 1) * own), 1) for own in picture.size)
        off = abs(math.log(width * picture.height / (height * picture.width)))
        sizes.append((round(off, 3), abs(length - side), (width, height)))
    return picture.resize(min(sizes)[2], Image.Resampling.LANCZOS)


def _best_quality(picture: Image.Image, max_bytes: int) -> bytes:
    """Find the WebP of the highest quality that fits; b"" if none does."""

    def encoded(quality: int) -> bytes:
        file = io.BytesIO()
        picture.save(file, "WEBP", quality=quality, method=6)
        return file.getvalue()

    return largest_within(encoded, max_bytes, -1, 101)
