"""Writing pixels as a picture file, tagged as sRGB if the format has tags.

The defaults of lossy formats are visually lossless: 47 to 50 dB (a photograph of 768x512 at 0.3 bpp).
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
from sgmethod.io.formats import FORMATS, WRITTEN, how_to_install
from sgmethod.io.kinds.format import Compress
from sgmethod.io.kinds.png import zlib_compress

SUFFIXES = {suffix: name for name, writer in WRITTEN.items() for suffix in writer.suffixes}


def picture_file(
    pixels: NDArray[np.uint8],
    kind: str,
    options: Mapping[str, Any] | None = None,
    compress: Compress = zlib_compress,
) -> bytes:
    """Encode sRGB pixels, uint8 [H, W, 3] or [H, W, 4] with alpha, which some formats composite over white.

    kind: a value of SUFFIXES; options: for Pillow's writer, instead of the format's; compress: for PNG, see encode_png.
    Raises ImageError for a picture too large for the format, or a format that this Pillow cannot write.
    """
    writer = WRITTEN[kind]
    height, width = pixels.shape[:2]
    if max(width, height) > writer.max_side:
        limit = f"{writer.max_side:,} pixels per side"
        raise ImageError(f"{kind} has at most {limit}, not {width:,} x {height:,}: take PNG")
    if not writer.has_alpha and pixels.shape[2] == 4:
        pixels = composited(pixels, WHITE)
    if writer.write is not None:
        return writer.write(pixels, compress)
    from PIL import Image, features

    if FORMATS[kind].pillow and not features.check(kind.lower()):
        raise ImageError(f"this Pillow cannot write {kind}: {how_to_install(kind)}")
    profile = {"icc_profile": _srgb_profile()} if writer.profile else {}
    file = io.BytesIO()
    try:
        Image.fromarray(pixels).save(file, kind, **(writer.options if options is None else options), **profile)
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
