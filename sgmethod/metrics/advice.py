"""Advice: pictures that Gaussians do not suit, and the file that suits them better.

Text, screenshots, charts and line art consist of flat areas with sharp edges between them. Photographs do not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from sgmethod.errors import ImageError
from sgmethod.io.image import read_image_8_bit
from sgmethod.io.pictures import picture_file
from sgmethod.io.within import largest_within
from sgmethod.metrics import psnr
from sgmethod.scene import Pixels

Kind = Literal["webp", "avif"]

KINDS: tuple[Kind, ...] = ("webp", "avif")
EVERY = 8  # rows from one that is looked at to the next; those between are alike
JUMP = 64  # levels from one pixel to the next
# Of 72 photographs none had more than 0.59 and 0.06; of 21 drawn pictures 18 had more than 0.86 and 0.21.
FLAT, SHARP = 0.7, 0.1
CLEARLY_DB = 1.0
# For a screenshot, WebP of method 0 takes three times the bytes, and AVIF of speed 10 is 6 dB worse than of speed 6.
LOSSLESS_WEBP = {"lossless": True, "quality": 50, "method": 6}
QUICK_AVIF = {"speed": 8, "subsampling": "4:4:4"}
NEAR = 8  # AVIF qualities this close end the search
UNSUITED = "Gaussians do not suit text, screenshots, charts and line art"


@dataclass(frozen=True)
class Better:
    """A file that suits a picture clearly better than its encode, in no more bytes. psnr: dB, infinite for WebP."""

    kind: Kind
    data: bytes = field(repr=False)
    psnr: float


def is_drawn(pixels: Pixels) -> bool:
    """Whether a picture [H, W, C] is drawn or typeset, not a photograph.

    Most of its pixels equal their neighbours, and many of the others jump. Takes 2 ms for 0.4 megapixels.
    """
    rows = pixels[::EVERY, :, :3]
    changes = int((rows[:, 1:] != rows[:, :-1]).any(2).sum())
    green = rows[..., 1].astype(np.int16)
    jumps = int((np.abs(np.diff(green, axis=1)) > JUMP).sum())
    return changes <= (1 - FLAT) * rows[:, 1:, 0].size and jumps > SHARP * changes


def better_file(pixels: Pixels, size: int, db: float, kinds: Sequence[Kind] = KINDS) -> Better | None:
    """Find a better file for a drawn picture [H, W, 3 or 4], given the bytes and the PSNR of its encode.

    None for a photograph, and where neither lossless WebP nor quick AVIF, if among `kinds`, is clearly better.
    """
    if not is_drawn(pixels):
        return None
    try:
        if "webp" in kinds and len(data := picture_file(pixels, "WebP", LOSSLESS_WEBP)) <= size:
            return Better("webp", data, math.inf)
        if "avif" not in kinds or pixels.shape[2] == 4:
            return None
        data = _avif(pixels, size)
        reached = psnr(read_image_8_bit(data), pixels) if data else 0.0
    except ImageError:  # no such encoder here, or too large for it
        return None
    return Better("avif", data, reached) if reached >= db + CLEARLY_DB else None


def advice(better: Better | None, size: int, db: float) -> dict[str, str | None]:
    """Two figures for an encode: `advice`, a sentence on the better file, and `better`, its kind; None without one."""
    if better is None:
        return {"advice": None, "better": None}
    words = f"lossless WebP takes {len(better.data):,} bytes"
    if better.kind == "avif":
        words = f"AVIF has {better.psnr:.1f} dB in {len(better.data):,} bytes, this file {db:.1f} dB in {size:,}"
    return {"advice": f"{UNSUITED}: {words}", "better": better.kind}


def _avif(pixels: Pixels, size: int) -> bytes:
    """Return about the largest file of at most this size; b"" if none is so small."""
    return largest_within(
        lambda quality: picture_file(pixels, "AVIF", {"quality": quality, **QUICK_AVIF}), size, 0, 100, NEAR
    )
