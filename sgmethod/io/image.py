"""Reading image files into arrays.

read_header reads a header without decoding pixels; read_image_8_bit decodes the picture. Both follow the same rules. A
refused file raises an ImageError with one clear sentence, anything dropped an ImageWarning:

    formats        PNG, JPEG, WebP, TIFF, BMP, GIF, AVIF, PPM (PBM, PGM) and QOI; HEIC with the extra
                   `heif`, JPEG XL with the extra `jxl`; recognised by their first bytes, never by file name
    size           checked against ImageLimits from the header, before pixels are decoded
    frames         the first, with a warning if there are others. Further pictures inside a JPEG (previews, gain maps)
                   and previews and masks in a TIFF do not count. Animated JPEG XL is refused. Outside the first
                   frame of a GIF, the picture is transparent.
    whole          truncated files, files with missing pixels and damaged PNGs are refused; damage in other formats can
                   go unnoticed, because they have no checksums. A JPEG may lack its end marker.
    orientation    EXIF orientation is applied, as are rotation, mirroring and clean aperture of AVIF and HEIC. Invalid
                   EXIF data is ignored.
    colour         the result is sRGB. Stated colours are converted, relative colorimetric with black-point
                   compensation: the first present of PNG's cICP, ICC profile, sRGB, gAMA and cHRM; ICC profiles of
                   other formats, including BMP; the code points of AVIF and HEIC. An unusable profile is ignored, with
                   a warning. PQ and HLG are refused. Grey becomes three equal channels, palettes are expanded; CMYK
                   without a profile, YCbCr and LAB are converted by Pillow's plain formulas. QOI's flag for linear
                   light is ignored, because Pillow always sets it.
    depth          the result has 8 bits. 16-bit grey and RGB(A) are rounded last, after conversion of colours (before
                   it, if the profile uses tables) and transparency; AVIF, HEIC, JPEG XL and rarer 16-bit kinds (PNG's
                   grey with alpha, TIFF's premultiplied alpha, CMYK, PPM) keep the upper 8. Floats and integers beyond
                   16 bits are refused, because they do not say which value is white.
    transparency   kept in 8 bits if the caller wants it; else composited over white in sRGB values,
                   value * alpha + (1 - alpha), with a warning
    the rest       other metadata is dropped; Pillow may warn of damage in it
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from PIL import ImageFile

from sgmethod.errors import ImageError
from sgmethod.io import chunks, formats
from sgmethod.io.header import (
    ImageHeader,
    ImageLimits,
    Opened,
    check_jpeg_xl,
    is_still,
    only_image_errors,
    open_file,
    warn,
)
from sgmethod.io.levels import Samples, samples_of
from sgmethod.scene import Pixels

__all__ = ["ImageHeader", "ImageLimits", "read_header", "read_image_8_bit"]

# Random bytes, none of them 0xFF, to append to a JPEG without end marker: pixels that depend on them are missing.
RANDOM_TAILS = [bits.tobytes() for bits in np.random.default_rng(0).integers(0, 255, (4, 64), np.uint8)]

Values = TypeVar("Values", bound=npt.NDArray[Any])


def read_header(data: bytes, limits: ImageLimits | None = None) -> ImageHeader:
    """Read the header of an image file, without decoding pixels.

    Raises ImageError for an unknown format, a damaged header, samples of an unknown range, high dynamic range, or a
    size of zero or beyond limits. A file that passes can still have damaged pixels.
    """
    kind = formats.name_of(data)
    with only_image_errors(kind):
        if kind == "JPEG XL":
            header = check_jpeg_xl(data, limits)
            return ImageHeader(kind, header.width, header.height)
        opened = open_file(data, kind, limits)
        # Pillow's TIFF reader already reports the size after orientation.
        width, height = reversed(opened.size) if opened.orientation >= 5 else opened.size
        return ImageHeader(kind, width, height, is_still(opened.reader, data))


def read_image_8_bit(
    data: bytes, limits: ImageLimits | None = None, *, keep_alpha: bool = False, smaller: int = 1
) -> Pixels:
    """Decode an image file by the rules at the top of this module, to uint8 [H, W, 3], sRGB, C-contiguous.

    keep_alpha: return [H, W, 4] for a transparent picture instead of compositing it over white. smaller: a JPEG may be
    decoded at 1/2, 1/4 or 1/8 of its size, but not below 1 / smaller, in a fraction of the time.
    Warns with ImageWarning of anything dropped. Raises ImageError where read_header does, and if pixel data are damaged
    or missing.
    """
    samples, notes = _read(data, limits, keep_alpha, smaller)
    warn(notes)
    return samples.in_8_bits()


def _read(data: bytes, limits: ImageLimits | None, keep_alpha: bool, smaller: int = 1) -> tuple[Samples, list[str]]:
    """Decode the picture as displayed; also return notes on anything dropped."""
    kind = formats.name_of(data)
    with only_image_errors(kind):
        opened = open_file(data, kind, limits)
        if kind == "JPEG" and chunks.lacks_end(data):
            data = _with_end(data)
            opened = open_file(data, kind, limits)
        if kind == "JPEG" and smaller > 1:
            width, height = opened.reader.size
            opened.reader.draft(None, (max(width // smaller, 1), max(height // smaller, 1)))
        samples = upright_samples(opened, data, keep_alpha)
        if kind == "PNG":
            verified: ImageFile.ImageFile = formats.open_reader(data, kind)
            verified.verify()  # checks all checksums; decoding skips those of the pixels
    return samples, opened.notes


def upright_samples(opened: Opened, data: bytes | None, keep_alpha: bool) -> Samples:
    """Decode, crop and turn a picture as displayed, composited over white, with a note, unless alpha is kept."""
    width, height = opened.reader.size
    samples = samples_of(opened.reader, data, opened.colour, opened.frame)
    if samples.levels.shape[:2] != (height, width):  # libheif crops as it decodes
        raise ImageError("the decoded image does not have the size stated in its header")
    if not keep_alpha:
        samples = without_alpha(samples, opened.notes)
    x0, y0, x1, y1 = opened.crop or (0, 0, width, height)
    alpha = samples.alpha
    return replace(
        samples,
        levels=_turn(samples.levels[y0:y1, x0:x1], opened.orientation),
        alpha=None if alpha is None else _turn(alpha[y0:y1, x0:x1], opened.orientation),
    )


def _with_end(jpeg: bytes) -> bytes:
    """Complete a JPEG that lacks its end marker. Raises ImageError if pixels are missing too."""
    jpeg = jpeg.rstrip(b"\xff")  # the first half of a marker
    number = int.from_bytes(([b"\7", *re.findall(rb"\xff([\xd0-\xd7])", jpeg)])[-1], "big")
    restart = bytes([0xFF, 0xD0 + (number + 1) % 8])  # missing pixels may continue with the next restart marker
    completed = jpeg + chunks.JPEG_END  # missing pixels become grey
    tails = [bits + restart + bits + chunks.JPEG_END for bits in RANDOM_TAILS]
    ended, *others = (
        np.asarray(formats.open_reader(data, "JPEG")) for data in (completed, *(jpeg + tail for tail in tails))
    )
    if not all(np.array_equal(ended, other) for other in others):
        raise ImageError("the JPEG is truncated")
    return completed


def without_alpha(samples: Samples, notes: list[str]) -> Samples:
    """Composite over white, with a note if the picture is transparent."""
    if samples.alpha is not None:
        notes.append("transparency is composited over white")
    return samples.over_white()


def _turn(pixels: Values, orientation: int) -> Values:
    """Undo an EXIF orientation (EXIF 2.32, table 6): flip rows, flip columns, swap the two."""
    turned: npt.NDArray[Any] = pixels
    if orientation in (3, 4, 6, 7):
        turned = turned[::-1]
    if orientation in (2, 3, 7, 8):
        turned = turned[:, ::-1]
    if orientation >= 5:
        turned = turned.swapaxes(0, 1)
    return np.ascontiguousarray(turned)  # type: ignore[return-value]
