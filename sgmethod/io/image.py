"""Image files to arrays.

read_header looks at a file without decoding a pixel of it; read_image decodes it. The same rules hold for
both, and whatever they refuse is an ImageError with one clear sentence; what they leave out is an ImageWarning:

    formats        PNG, JPEG, WebP, TIFF, BMP, GIF, AVIF, PPM (PBM, PGM) and QOI; HEIC with the extra
                   `heif`, JPEG XL with the extra `jxl`; known by their first bytes, never by a file name
    size           checked against ImageLimits from the header, before pixels are decoded
    frames         the first, with a warning if there are others. A JPEG with pictures behind its own (a preview, a
                   gain map) is one picture, as is a TIFF with previews and masks behind its first. A JPEG XL that
                   moves is refused. Where a GIF's first frame does not cover its screen, nothing is seen.
    whole          a file that is cut short or leaves pixels unset is refused, as is a PNG with any damage;
                   damage inside other formats can go unseen, because they carry no checksum. A JPEG may lack its end
                   marker.
    orientation    the EXIF orientation is applied; EXIF data that cannot be parsed counts as absent. So are rotation,
                   mirroring and clean aperture of AVIF and HEIC.
    colour         sRGB comes out. What a file states is converted, relative colorimetric with black-point
                   compensation: PNG's cICP, ICC profile, sRGB, gAMA and cHRM, the first of them that it has; ICC
                   profiles of the others, BMP among them; the code points of AVIF and HEIC. A profile that cannot be
                   used is left out, with a warning. PQ and HLG are refused. Grey becomes three equal channels, palettes
                   are expanded; CMYK without a profile, YCbCr and LAB are converted by Pillow's plain formulas. That a
                   QOI file holds light is not believed: Pillow writes so into each.
    depth          16-bit grey and 16-bit RGB(A) keep all their bits, through the conversion of colours too unless the
                   profile is one of tables; AVIF, HEIC, JPEG XL and rarer 16-bit kinds (PNG's grey with alpha, TIFF's
                   premultiplied alpha, CMYK, PPM) keep the upper 8. Floats and integers beyond 16 bits are refused,
                   because they do not say which value is white.
    transparency   kept where the caller keeps it, in 8 bits; else composited over white, in values of sRGB,
                   value * alpha + (1 - alpha), with a warning
    the rest       other metadata is left out
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
from sgmethod.io.levels import Samples, Uint8Array, samples_of, values_of

__all__ = ["ImageHeader", "ImageLimits", "read_header", "read_image", "read_image_8_bit"]

# What may follow the pixels of a JPEG that lacks its end; no byte of it begins a marker.
BEHIND = [bits.tobytes() for bits in np.random.default_rng(0).integers(0, 255, (4, 64), np.uint8)]

Float32Array = npt.NDArray[np.float32]
Values = TypeVar("Values", bound=npt.NDArray[Any])


def read_header(data: bytes, limits: ImageLimits | None = None) -> ImageHeader:
    """The header of an image file, read without decoding pixels.

    Raises ImageError if data is none of the formats, has a damaged header, samples of an unknown range, colours of
    high dynamic range, or a size of zero or beyond limits. A file that passes can still have damaged pixels.
    """
    kind = formats.name_of(data)
    with only_image_errors(kind):
        if kind == "JPEG XL":
            told = check_jpeg_xl(data, limits)
            return ImageHeader(kind, told.width, told.height, "RGB", True)
        opened = open_file(data, kind, limits)
        reader = opened.reader
        # Pillow's TIFF reader has the size of the turned picture.
        width, height = reversed(opened.size) if opened.orientation >= 5 else opened.size
        return ImageHeader(kind, width, height, reader.mode, is_still(reader, data))


def read_image(data: bytes, limits: ImageLimits | None = None) -> Float32Array:
    """Decode an image file by the rules at the top of this module.

    Returns float32 [H, W, 3] in [0, 1], sRGB, C-contiguous. Warns with ImageWarning of what is left out.
    Raises ImageError where read_header does, and if pixel data are damaged or missing.
    """
    samples, notes = _read(data, limits, keep_alpha=False)
    warn(notes)
    values: Float32Array = samples.levels
    if values.dtype != np.float32:
        values = values_of(samples.levels, samples.white)
    return np.ascontiguousarray(np.broadcast_to(values, (*values.shape[:2], 3)))


def read_image_8_bit(data: bytes, limits: ImageLimits | None = None, *, keep_alpha: bool = False) -> Uint8Array:
    """The same picture, uint8 [H, W, 3]: all that an encode uses of it, in a quarter of the memory.

    keep_alpha: [H, W, 4] in place of a mixture with white where anything can be seen through. Samples of more bits,
    and mixtures, are rounded.
    """
    samples, notes = _read(data, limits, keep_alpha)
    warn(notes)
    return samples.in_8_bits()


def _read(data: bytes, limits: ImageLimits | None, keep_alpha: bool) -> tuple[Samples, list[str]]:
    """The picture as it is to be seen, and what is left out of it."""
    kind = formats.name_of(data)
    with only_image_errors(kind):
        opened = open_file(data, kind, limits)
        if kind == "JPEG" and chunks.lacks_end(data):
            data = _with_end(data)
            opened = open_file(data, kind, limits)
        samples = upright_samples(opened, data, keep_alpha)
        if kind == "PNG":
            verified: ImageFile.ImageFile = formats.open_reader(data, kind)
            verified.verify()  # all checksums; decoding skips those of the pixels
    return samples, opened.notes


def upright_samples(opened: Opened, data: bytes | None, keep_alpha: bool) -> Samples:
    """Turned as the picture is to be seen, and over white unless alpha is kept, which is noted."""
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
    """A JPEG that lacks its end marker. Raises ImageError if it lacks pixels: other bits behind it then make others."""
    jpeg = jpeg.rstrip(b"\xff")  # the first half of a marker
    number = int.from_bytes(([b"\7", *re.findall(rb"\xff([\xd0-\xd7])", jpeg)])[-1], "big")
    restart = bytes([0xFF, 0xD0 + (number + 1) % 8])  # where pixels may be due to go on, if they do
    readers = [formats.open_reader(jpeg + bits + restart + bits + chunks.JPEG_END, "JPEG") for bits in BEHIND]
    ended, *others = map(np.asarray, readers)
    if not all(np.array_equal(ended, other) for other in others):
        raise ImageError("the JPEG is truncated")
    return jpeg + chunks.JPEG_END


def without_alpha(samples: Samples, notes: list[str]) -> Samples:
    """Over white, which is noted."""
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
