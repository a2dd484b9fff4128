"""A picture as the best small WebP for a page without scripts."""

from __future__ import annotations

import base64
import io

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
    scale = min(side / max(picture.size), 1)
    width, height = (max(round(scale * own), 1) for own in picture.size)
    return picture.resize((width, height), Image.Resampling.LANCZOS)


def _best_quality(picture: Image.Image, max_bytes: int) -> bytes:
    """Find the WebP of the highest quality that fits; b"" if none does."""

    def encoded(quality: int) -> bytes:
        file = io.BytesIO()
        picture.save(file, "WEBP", quality=quality, method=6)
        return file.getvalue()

    return largest_within(encoded, max_bytes, -1, 101)
