"""BMP, with the colour profile that Pillow does not expose."""

from __future__ import annotations

import struct

from sgmethod.io.kinds.format import Format

V5, EMBEDDED = 124, b"DEBM"  # size of the header; colour space PROFILE_EMBEDDED


def bmp_profile(data: bytes) -> bytes | None:
    """Return the ICC profile embedded in a BMP file, if any."""
    if int.from_bytes(data[14:18], "little") != V5 or data[70:74] != EMBEDDED:
        return None
    start, length = struct.unpack_from("<II", data, 126)
    return data[14 + start : 14 + start + length]


FORMAT = Format("BMP", (".bmp", ".dib"), ("PIL.BmpImagePlugin", "BmpImageFile"), b"BM")
