"""Previews as data URIs, for pages without a decoder."""

from __future__ import annotations

import base64
import io

from PIL import Image

from sgmethod.decoder import SgFile

LONG_SIDE = 32  # pixels: a browser enlarges them smoothly, so more would only add bytes
QUALITY = 60


def data_uri(data: bytes) -> str:
    """Convert an .sg file to a WebP of about 200 bytes, at most LONG_SIDE pixels wide and high."""
    file = SgFile(data)
    pixels = file.pixels(scale=min(LONG_SIDE / max(file.size), 1.0))
    webp = io.BytesIO()
    Image.fromarray(pixels).save(webp, "WEBP", quality=QUALITY, method=6)
    return f"data:image/webp;base64,{base64.b64encode(webp.getvalue()).decode()}"
