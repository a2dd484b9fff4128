"""PPM, and its siblings PGM and PBM, which are only read. Files have no tags, and so do not say that they are sRGB."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sgmethod.io.kinds.format import Compress, Format, Writer


def encode_ppm(pixels: NDArray[np.uint8], _: Compress) -> bytes:
    """Encode pixels, uint8 [H, W, 3], as a binary PPM file."""
    height, width = pixels.shape[:2]
    return b"P6\n%d %d\n255\n" % (width, height) + pixels.tobytes()


FORMAT = Format(
    "PPM",
    (".ppm", ".pgm", ".pbm", ".pnm"),
    ("PIL.PpmImagePlugin", "PpmImageFile"),
    rb"P[1-6][ \t\n\r#]",
    writer=Writer((".ppm",), has_alpha=False, write=encode_ppm),
)
