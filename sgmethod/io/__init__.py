"""Pictures and files, in and out.

Image files, Pillow images and arrays are converted to sRGB levels. Decoded pixels are written in five file formats;
every file is written completely or not at all.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sgmethod.io.files import write_atomically
    from sgmethod.io.image import read_image, read_image_8_bit
    from sgmethod.io.png import encode_png

__all__ = ["encode_png", "read_image", "read_image_8_bit", "write_atomically"]

_HOME = {"encode_png": "png", "read_image": "image", "read_image_8_bit": "image", "write_atomically": "files"}


def __getattr__(name: str) -> Any:
    """Import on first use: decoding needs none of the code that reads pictures."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
