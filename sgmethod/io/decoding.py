"""The second step: decode the samples of any Pillow reader as they are stored, in their own colours and orientation."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from sgmethod.errors import ImageError
from sgmethod.io import formats
from sgmethod.io.colour import Colour, Levels
from sgmethod.io.kinds import png
from sgmethod.io.opening import BITS_PER_SAMPLE, ImageLimits, Opened

# A TIFF tag, and a value
PHOTOMETRIC, WHITE_IS_ZERO = 262, 0


@dataclass(frozen=True)
class Picture:
    """A decoded picture, on its way from the file's form to upright sRGB.

    levels [H, W, C]: C is 1 for grey, 3 for RGB and 4 for CMYK; `white` is white; alpha [H, W, 1]: `opaque` is opaque;
    None for an opaque picture. The other fields are as in Opened: what remains to be undone, and warnings.
    """

    levels: npt.NDArray[Any]
    white: int
    alpha: npt.NDArray[Any] | None = None
    opaque: int = 1
    orientation: int = 1
    colour: Colour = None
    notes: tuple[str, ...] = ()


def decode(opened: Opened, smaller: int = 1) -> Picture:
    """Decode all samples, with alpha if any pixel is transparent. smaller: see read_image_8_bit."""
    reader, data = opened.reader, opened.data
    if reader.format == "JPEG" and smaller > 1:
        reader.draft(None, (max(reader.width // smaller, 1), max(reader.height // smaller, 1)))
    key = reader.info.pop("transparency", None) if reader.mode != "P" else None
    size = reader.size
    levels, white = _stored(opened)
    if levels.shape[1::-1] != size:  # libheif crops as it decodes
        raise ImageError("the decoded image does not have the size stated in its header")
    if data is not None and reader.format == "PNG":
        formats.open_reader(data, "PNG").verify()  # checks all checksums; decoding skips those of the pixels
    alpha = None
    if levels.shape[2] == 2 or (levels.shape[2] == 4 and reader.mode != "CMYK"):
        levels, alpha = levels[..., :-1], levels[..., -1:]
    elif key is not None:
        if data is not None and reader.format == "PNG":
            key = _transparent_in_png(data, levels.shape[2], white)
        alpha = np.any(levels != np.bitwise_and(key, white), axis=2, keepdims=True) * levels.dtype.type(white)
    if opened.frame is not None:
        x0, y0, x1, y1 = opened.frame
        covered = np.zeros((*levels.shape[:2], 1), levels.dtype)
        covered[y0:y1, x0:x1] = white if alpha is None else alpha[y0:y1, x0:x1]
        alpha = covered
    if opened.aperture is not None:
        x0, y0, x1, y1 = opened.aperture
        levels, alpha = levels[y0:y1, x0:x1], alpha if alpha is None else alpha[y0:y1, x0:x1]
    if alpha is not None and alpha.min() == white:
        alpha = None
    return Picture(levels, white, alpha, white, opened.orientation, opened.colour, opened.notes)


def from_array(pixels: npt.NDArray[Any]) -> Picture:
    """Check an array. Raises ImageError for a wrong type or shape, other values, or a size beyond ImageLimits."""
    pixels = np.asarray(pixels)  # np.matrix would not become three-dimensional
    pixels = pixels.astype(pixels.dtype.newbyteorder("="), copy=False)
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.ndim != 3 or pixels.shape[2] not in (1, 3, 4) or 0 in pixels.shape:
        raise ImageError(f"an image must be [H, W], or [H, W, C] with 1, 3 or 4 channels, got {list(pixels.shape)}")
    ImageLimits().check(pixels.shape[1], pixels.shape[0])
    if pixels.dtype not in (np.uint8, np.uint16):
        if not np.issubdtype(pixels.dtype, np.floating):
            raise ImageError(f"an image must be uint8, uint16 or floating-point values in [0, 1], got {pixels.dtype}")
        check_range(float(pixels.min()), float(pixels.max()))
    white = int(np.iinfo(pixels.dtype).max) if pixels.dtype.kind == "u" else 1
    if pixels.shape[2] < 4:
        return Picture(pixels, white)
    alpha = pixels[..., 3:]
    return Picture(pixels[..., :3], white, None if alpha.min() == white else alpha, white)


def check_range(minimum: float, maximum: float) -> None:
    """Raise ImageError unless the minimum and the maximum of an image lie in [0, 1]."""
    if not minimum <= maximum:  # a minimum is NaN if any value is
        raise ImageError("image values must lie in [0, 1], got NaN")
    if minimum < 0 or maximum > 1:
        raise ImageError(f"image values must lie in [0, 1], got {minimum:.8g} to {maximum:.8g}: rescale or clip them")


def _transparent_in_png(data: bytes, channels: int, white: int) -> npt.NDArray[Any]:
    """Return the transparent colour of a PNG without palette, in levels up to `white`.

    Pillow keeps the bits above the file's depth, which are to be ignored (PNG, third edition, 11.3.1.1), and scales
    samples of 1, 2 and 4 bits to 8, but not this colour.
    """
    highest = (1 << data[24]) - 1
    stored = np.frombuffer(png.png_chunks(data)[b"tRNS"], ">u2", channels).astype(np.int64)
    return (stored & highest) * (white // highest)


def _stored(opened: Opened) -> tuple[Levels, int]:
    """Levels [H, W, C] as stored, and their white. C: 1 for grey, 3 for RGB, one more with alpha; 4 for CMYK."""
    reader, data = opened.reader, opened.data
    if data is not None and _rawmode(reader)[:-1] in ("RGB;16", "RGBA;16", "RGBX;16"):
        return _load_16_bit_rgb(reader, data), 65535
    if reader.mode == "I":  # a 16-bit PPM; others are refused
        return _load(reader)[..., None].astype(np.uint16), 65535
    if reader.mode.startswith("I;16"):
        levels, white = _load(reader)[..., None], 65535
        tags = getattr(reader, "tag_v2", None)
        if tags is not None:  # a TIFF file
            white = (1 << tags[BITS_PER_SAMPLE][0]) - 1  # 12 bits are stored as they are
            levels = white - levels if tags.get(PHOTOMETRIC, 0) == WHITE_IS_ZERO else levels
        return levels, white
    if reader.mode == "CMYK" and opened.colour is not None:  # else Pillow's plain formula converts it
        return _load(reader), 255
    if reader.has_transparency_data:
        return _load(reader, "RGBA"), 255
    return (_load(reader, "L")[..., None] if reader.mode in ("1", "L") else _load(reader, "RGB")), 255


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
