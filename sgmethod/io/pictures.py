"""Writing pixels as PNG, JPEG, WebP, AVIF or PPM, tagged as sRGB except for PPM, which has no tags.

PNG and PPM are lossless. The defaults of the others are visually lossless: 47 to 50 dB (a photograph of 768x512 at 0.3
bpp).
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sgmethod.errors import ImageError
from sgmethod.io.compositing import WHITE, composited
from sgmethod.io.png import Compress, encode_png, zlib_compress

SUFFIXES = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".webp": "WebP", ".avif": "AVIF", ".ppm": "PPM"}
OPAQUE = ("JPEG", "PPM")
# Of libjpeg, which prints a line of its own; of the format; and for libavif, which reads no side above 32,768.
MAX_SIDES = {"JPEG": 65_500, "WebP": 16_383, "AVIF": 16_384}
OPTIONS: dict[str, dict[str, Any]] = {
    "JPEG": {"quality": 95, "subsampling": "4:4:4"},
    "WebP": {"quality": 95},
    "AVIF": {"quality": 90, "subsampling": "4:4:4", "speed": 8},  # tagged as sRGB by code points
}


def picture_file(
    pixels: NDArray[np.uint8],
    kind: str,
    options: Mapping[str, Any] | None = None,
    compress: Compress = zlib_compress,
) -> bytes:
    """Encode sRGB pixels, uint8 [H, W, 3] or [H, W, 4] with alpha, which JPEG and PPM composite over white.

    kind: a value of SUFFIXES; options: for Pillow's JPEG, WebP or AVIF writer, instead of OPTIONS; compress: for PNG,
    see encode_png.
    Raises ImageError for a picture too large for the format, or a format that this Pillow cannot write.
    """
    if kind == "PNG":
        return encode_png(pixels, compress)
    height, width = pixels.shape[:2]
    if max(width, height) > (limit := MAX_SIDES.get(kind, width + height)):
        raise ImageError(f"{kind} has at most {limit:,} pixels per side, not {width:,} x {height:,}: take PNG")
    if kind in OPAQUE and pixels.shape[2] == 4:
        pixels = composited(pixels, WHITE)
    if kind == "PPM":
        return b"P6\n%d %d\n255\n" % (width, height) + pixels.tobytes()
    from PIL import Image, features

    if kind == "AVIF" and not features.check("avif"):
        raise ImageError("this Pillow cannot write AVIF: pip install 'pillow>=11.3'")
    profile = {} if kind == "AVIF" else {"icc_profile": _srgb_profile()}
    file = io.BytesIO()
    try:
        Image.fromarray(pixels).save(file, kind, **(OPTIONS[kind] if options is None else options), **profile)
    except (OSError, ValueError) as error:
        reason = str(error) or type(error).__name__
        raise ImageError(f"cannot write {width} x {height} pixels as {kind} ({reason})") from error
    return file.getvalue()


@cache
def _srgb_profile() -> bytes:
    """Little CMS's sRGB profile, without its creation time, so that the same pixels give the same file."""
    from PIL import ImageCms

    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    return profile[:24] + bytes(12) + profile[36:]
