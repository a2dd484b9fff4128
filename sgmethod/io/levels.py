"""Decoding the samples of any Pillow reader to sRGB levels."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from sgmethod.io import chunks, colour, formats
from sgmethod.io.colour import Colour, Levels, Transform
from sgmethod.scene import Pixels

Float32Array = npt.NDArray[np.float32]

# TIFF tags, and a value
BITS_PER_SAMPLE, PHOTOMETRIC = 258, 262
WHITE_IS_ZERO = 0

Box = tuple[int, int, int, int]  # x0, y0, x1, y1


@dataclass(frozen=True)
class Samples:
    """A decoded picture.

    levels [H, W, 1 or 3]: sRGB, of which `white` is white; alpha [H, W, 1]: `opaque` is opaque; None for an opaque
    picture.
    """

    levels: npt.NDArray[Any]
    white: int
    alpha: npt.NDArray[Any] | None = None
    opaque: int = 1

    def over_white(self) -> Samples:
        """Composite over white: value * alpha + (1 - alpha)."""
        if self.alpha is None:
            return self
        part = values_of(self.alpha, self.opaque)
        values = values_of(self.levels, self.white)
        values *= part
        values += 1 - part
        return Samples(values, 1)

    def in_8_bits(self) -> Pixels:
        """Convert to levels 0 to 255, C-contiguous: [H, W, 3], or [H, W, 4] with alpha."""
        height, width = self.levels.shape[:2]
        colour = np.broadcast_to(self.levels, (height, width, 3))
        if self.alpha is None:
            return to_8_bit(colour, self.white)
        return np.dstack([to_8_bit(colour, self.white), to_8_bit(self.alpha, self.opaque)])


def values_of(levels: npt.NDArray[Any], peak: int) -> Float32Array:
    """Convert levels in [0, peak] to float32 in [0, 1]; always a copy."""
    values = levels.astype(np.float32)
    if peak != 1:
        values /= peak
    return values


def to_8_bit(levels: npt.NDArray[Any], peak: int) -> Pixels:
    """Convert levels in [0, peak] to uint8, C-contiguous, row by row to save memory; uint8 is left as it is."""
    if levels.dtype == np.uint8:
        return np.ascontiguousarray(levels, np.uint8)
    pixels = np.empty(levels.shape, np.uint8)
    for row, values in zip(pixels, levels, strict=True):
        row[...] = np.round(values_of(values, peak) * 255)
    return pixels


def samples_of(reader: Image.Image, data: bytes | None, stated: Colour, frame: Box | None = None) -> Samples:
    """Decode a picture, with alpha if any pixel is transparent.

    reader: not yet loaded; data: its file (without it, 16-bit RGB is decoded to 8 bits); stated: its colours; frame:
    the area with pixels, if not the whole picture.
    """
    key = reader.info.pop("transparency", None) if reader.mode != "P" else None
    levels, peak = _stored(reader, data, stated)
    alpha = None
    if levels.shape[2] in (2, 4):
        levels, alpha = levels[..., :-1], levels[..., -1:]
    elif key is not None:
        if data is not None and reader.format == "PNG":
            key = _transparent_in_png(data, levels.shape[2], peak)
        alpha = np.any(levels != np.bitwise_and(key, peak), axis=2, keepdims=True) * levels.dtype.type(peak)
    if frame is not None:
        x0, y0, x1, y1 = frame
        covered = np.zeros((*levels.shape[:2], 1), levels.dtype)
        covered[y0:y1, x0:x1] = peak if alpha is None else alpha[y0:y1, x0:x1]
        alpha = covered
    opaque = peak
    if stated is not None and not (isinstance(stated, Transform) and stated.mode == "CMYK"):
        levels, peak = stated.convert(levels, peak)
    if alpha is None or alpha.min() == opaque:
        return Samples(levels, peak)
    return Samples(levels, peak, alpha, opaque)


def _transparent_in_png(data: bytes, channels: int, peak: int) -> npt.NDArray[Any]:
    """Return the transparent colour of a PNG without palette, in levels up to `peak`.

    Pillow keeps the bits above the file's depth, which are to be ignored (PNG, third edition, 11.3.1.1), and scales
    samples of 1, 2 and 4 bits to 8, but not this colour.
    """
    highest = (1 << data[24]) - 1
    stored = np.frombuffer(chunks.of_png(data)[b"tRNS"], ">u2", channels).astype(np.int64)
    return (stored & highest) * (peak // highest)


def _stored(reader: Image.Image, data: bytes | None, stated: Colour) -> tuple[Levels, int]:
    """Levels [H, W, C] as stored, and their white. C: 1 for grey, 3 for RGB, one more with alpha."""
    if data is not None and _rawmode(reader)[:-1] in ("RGB;16", "RGBA;16", "RGBX;16"):
        return _load_16_bit_rgb(reader, data), 65535
    if reader.mode == "I":  # a 16-bit PPM; others are refused
        return _load(reader)[..., None].astype(np.uint16), 65535
    if reader.mode.startswith("I;16"):
        levels, peak = _load(reader)[..., None], 65535
        tags = getattr(reader, "tag_v2", None)
        if tags is not None:  # a TIFF file
            peak = (1 << tags[BITS_PER_SAMPLE][0]) - 1  # 12 bits are stored as they are
            levels = peak - levels if tags.get(PHOTOMETRIC, 0) == WHITE_IS_ZERO else levels
        return levels, peak
    if reader.mode == "CMYK" and isinstance(stated, Transform):
        return stated.convert(_load(reader), 255)
    return _load_8_bit(reader), 255


def _rawmode(reader: Image.Image) -> str:
    """Pillow's name for the order of bits and bytes in the file; "" if not yet known."""
    tiles = getattr(reader, "tile", [])
    arguments = tiles[0][3] if tiles else ""
    return arguments if isinstance(arguments, str) else str(arguments[0]) if arguments else ""


def _load(reader: Image.Image, mode: str | None = None) -> Levels:
    """Decode, and convert to another of Pillow's modes if given."""
    # Pillow's TIFF reader would take a missing orientation from XMP, and so contradict the size in the header.
    reader.info.pop("xmp", None)
    reader.load()
    if reader.mode == "La":  # the only mode that Pillow converts it to
        reader = reader.convert("LA")
    return np.asarray(reader.convert(mode) if mode else reader)


def _load_8_bit(reader: Image.Image) -> Levels:
    """Decode to uint8 [H, W, 1, 3 or 4]."""
    if reader.has_transparency_data:
        return _load(reader, "RGBA")
    return _load(reader, "L")[..., None] if reader.mode in ("1", "L") else _load(reader, "RGB")


def _load_16_bit_rgb(reader: Image.Image, data: bytes) -> Levels:
    """Decode to uint16 [H, W, 3 or 4].

    Pillow keeps only the upper byte of each sample. A second reading, with the byte order swapped, keeps the lower one.
    """
    opposite = {"L": "B", "B": "L", "N": "B" if sys.byteorder == "little" else "L"}
    rawmode = _rawmode(reader)
    swapped = rawmode[:-1] + opposite[rawmode[-1]]
    lower = formats.open_reader(data, str(reader.format))
    lower.tile = [
        tile._replace(args=swapped if isinstance(tile.args, str) else (swapped, *(tile.args or ())[1:]))
        for tile in lower.tile
    ]
    return _load(reader).astype(np.uint16) << 8 | _load(lower)


def stated_colour(reader: Image.Image, mode: str, data: bytes | None) -> Colour:
    """Colours stated by a file, by the most exact statement (PNG, third edition, 4.3); None for sRGB.

    mode: of the decoded samples, "L", "RGB" or "CMYK".
    Raises ProfileError for an unusable profile, ImageError for PQ and HLG.
    """
    info, kind = reader.info, reader.format if data is not None else None
    stated = chunks.of_png(data) if data is not None and kind == "PNG" else {}
    if len(cicp := stated.get(b"cICP", b"")) == 4:
        return colour.of_code_points(cicp[0], cicp[1])
    if b"iCCP" in stated:
        return colour.of_profile(colour.inflated(stated[b"iCCP"]), mode)
    if "icc_profile" in info:
        return colour.of_profile(info["icc_profile"] or b"", mode)
    if data is not None and kind == "BMP" and (profile := chunks.profile_of_bmp(data)) is not None:
        return colour.of_profile(profile, mode)
    if data is not None and kind in ("AVIF", "HEIF") and (points := chunks.code_points(data)) is not None:
        return colour.of_code_points(*points)
    if nclx := info.get("nclx_profile"):  # of a Pillow image opened by pillow_heif
        return colour.of_code_points(nclx["color_primaries"], nclx["transfer_characteristics"])
    # A Pillow image opened from a PNG still has its sRGB, gAMA and cHRM.
    return None if info.get("srgb") is not None else colour.of_png(info)
