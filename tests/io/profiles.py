"""ICC profiles, made by hand (ICC.1:2022): of matrices and curves, of one grey curve, of tables for CMYK."""

from __future__ import annotations

import struct
from itertools import product

Tag = bytes
WHITE = (0.9642, 1.0, 0.8249)  # D50

# Red, green and blue under D50.
DISPLAY_P3 = ((0.51512, 0.24120, -0.00105), (0.29198, 0.69225, 0.04189), (0.15710, 0.06657, 0.78407))
ADOBE_RGB = ((0.60974, 0.31111, 0.01947), (0.20528, 0.62567, 0.06087), (0.14919, 0.06322, 0.74457))
PROPHOTO = ((0.79767, 0.28804, 0.0), (0.13519, 0.71188, 0.0), (0.03134, 0.00009, 0.82491))
SRGB = ((0.43607, 0.22249, 0.01392), (0.38515, 0.71687, 0.09708), (0.14307, 0.06061, 0.71410))


def fixed(*values: float) -> bytes:
    """As s15Fixed16."""
    return struct.pack(f">{len(values)}i", *(round(value * 65536) for value in values))


def gamma(exponent: float) -> Tag:
    """A curve of version 2: one exponent."""
    return b"curv" + struct.pack(">IIH", 0, 1, round(exponent * 256))


def table(*values: float) -> Tag:
    """A curve of version 2: evenly spaced values."""
    return b"curv" + struct.pack(f">II{len(values)}H", 0, len(values), *(round(value * 65535) for value in values))


def parametric(kind: int, *parameters: float) -> Tag:
    """A curve of version 4."""
    return b"para" + struct.pack(">IHH", 0, kind, 0) + fixed(*parameters)


SRGB_CURVE = parametric(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)


def profile(space: bytes, tags: dict[bytes, Tag], pcs: bytes = b"XYZ ", kind: bytes = b"mntr") -> bytes:
    named = b"desc\0\0\0\0" + struct.pack(">I", 5) + b"test\0" + bytes(79)
    tags = {b"desc": named, b"wtpt": b"XYZ \0\0\0\0" + fixed(*WHITE), b"cprt": b"text\0\0\0\0none\0", **tags}
    entries, body, at = b"", b"", 132 + 12 * len(tags)
    for name, tag in tags.items():
        entries += name + struct.pack(">II", at + len(body), len(tag))
        body += tag + bytes(-len(tag) % 4)
    header = struct.pack(">I4s", at + len(body), b"lcms") + bytes([2, 0x40, 0, 0]) + kind + space + pcs
    header += bytes(12) + b"acsp" + bytes(28) + fixed(*WHITE)
    return header.ljust(128, b"\0") + struct.pack(">I", len(tags)) + entries + body


def rgb(colorants: tuple[tuple[float, ...], ...], curve: Tag = SRGB_CURVE, **more: Tag) -> bytes:
    """RGB of a matrix and one curve."""
    names = zip((b"rXYZ", b"gXYZ", b"bXYZ"), colorants, strict=True)
    tags = {name: b"XYZ \0\0\0\0" + fixed(*values) for name, values in names}
    tags |= dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), curve)
    return profile(b"RGB ", {**tags, **{name.encode(): tag for name, tag in more.items()}})


def grey(curve: Tag) -> bytes:
    return profile(b"GRAY", {b"kTRC": curve})


def _lut(channels: int, corners: list[tuple[int, int, int]]) -> Tag:
    """A table of the corners of a cube, to Lab in 8 bits."""
    straight = bytes(range(256))
    head = b"mft1\0\0\0\0" + bytes([channels, 3, 2, 0]) + fixed(1, 0, 0, 0, 1, 0, 0, 0, 1)
    return head + straight * channels + bytes(value for corner in corners for value in corner) + straight * 3


def cmyk() -> bytes:
    """A press: paper is white, each ink takes from L* and moves a* and b*, black is black."""
    corners = []
    for c, m, y, k in product((0, 1), repeat=4):
        lightness = 0 if k else max(255 - 110 * c - 130 * m - 30 * y, 40)
        tint = 0 if k else 1
        corners.append((lightness, 128 + tint * (74 * m - 37 * c), 128 + tint * (93 * y - 50 * c - 5 * m)))
    lut = _lut(4, corners)
    return profile(b"CMYK", {b"A2B0": lut, b"A2B1": lut}, b"Lab ", b"prtr")


def rgb_by_table() -> bytes:
    """RGB by a table, which swaps nothing but makes all colours grey."""
    corners = [(round(255 * (0.3 * r + 0.6 * g + 0.1 * b)), 128, 128) for r, g, b in product((0, 1), repeat=3)]
    lut = _lut(3, corners)
    return profile(b"RGB ", {b"A2B0": lut, b"A2B1": lut}, b"Lab ")
