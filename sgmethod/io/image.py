"""Reading any picture as 8-bit sRGB: image files, Pillow images and arrays.

_pixels() lists the steps. A refused picture raises an ImageError with one clear sentence, anything dropped an
ImageWarning:

    formats        those in formats/, recognised by their first bytes, never by file name
    size           checked against ImageLimits from the header, before pixels are decoded
    frames         the first, with a warning if there are others. Further pictures inside a JPEG (thumbnails, gain maps)
                   and thumbnails in a TIFF do not count. Animated JPEG XL is refused. Outside the first frame of a GIF,
                   the picture is transparent.
    whole          truncated files, files with missing pixels and damaged PNGs are refused, unless the program has set
                   Pillow's LOAD_TRUNCATED_IMAGES; damage in other formats can go unnoticed, because they have no
                   checksums
    orientation    EXIF orientation is applied, as are rotation, mirroring and clean aperture of AVIF and HEIC. Invalid
                   EXIF data is ignored.
    colour         the result is sRGB. Stated colours are converted, relative colorimetric (with black-point
                   compensation only if the profile uses tables): the first present of PNG's cICP, ICC profile, sRGB,
                   gAMA and cHRM; ICC profiles of other formats; the code points of AVIF and HEIC. An unusable profile
                   is ignored, with a warning. PQ and HLG are refused. Grey becomes three equal channels, palettes are
                   expanded; CMYK without a profile, YCbCr and LAB are converted by Pillow's plain formulas. QOI's flag
                   for linear light is ignored, because Pillow always sets it.
    depth          the result has 8 bits. 16-bit grey and RGB(A) are rounded last, after conversion of colours (before
                   it, if the profile uses tables) and transparency; AVIF, HEIC, JPEG XL and rarer 16-bit kinds (PNG's
                   grey with alpha, TIFF's premultiplied alpha, CMYK, PPM) keep the upper 8. Floats and integers beyond
                   16 bits are refused, because they do not say which value is white.
    transparency   kept in 8 bits if the caller wants it; else composited over white in sRGB values,
                   value * alpha + (1 - alpha), with a warning
    the rest       other metadata is dropped; Pillow may warn of damage in it
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from sgmethod.errors import NOTES, ImageError, ImageWarning, SgError
from sgmethod.io.decoding import Picture, decode, from_array
from sgmethod.io.files import checked_path
from sgmethod.io.formats import name_of
from sgmethod.io.opening import ImageLimits, check_header, open_file, open_pillow
from sgmethod.scene import Pixels

__all__ = ["ImageHeader", "ImageLimits", "Input", "read_header", "read_image_8_bit", "read_input"]

Input = str | os.PathLike[str] | bytes | bytearray | memoryview | Image.Image | npt.NDArray[Any]

PACKAGES = tuple(f"{folder}{os.sep}" for folder in (Path(__file__).parents[1], Path(Image.__file__).parent))


@dataclass(frozen=True)
class ImageHeader:
    """The header of an image file.

    format: one of formats.FORMATS; width, height: pixels, after EXIF orientation; still: whether it is the only picture
    in the file.
    """

    format: str
    width: int
    height: int
    still: bool = True


def read_header(data: bytes, limits: ImageLimits | None = None) -> ImageHeader:
    """Read the header of an image file, without decoding pixels.

    Raises ImageError for an unknown format, a damaged header, samples of an unknown range, high dynamic range, or a
    size of zero or beyond limits. A file that passes can still have damaged pixels.
    """
    kind, limits = name_of(data), limits or ImageLimits()
    with only_image_errors(kind):
        if (header := check_header(data, kind, limits)) is not None:
            return ImageHeader(kind, header.width, header.height)
        opened = open_file(data, kind, limits)
        # Pillow's TIFF reader already reports the size after orientation.
        width, height = reversed(opened.size) if opened.orientation >= 5 else opened.size
        return ImageHeader(kind, width, height, opened.still)


def read_input(image: Input, *, keep_alpha: bool = False) -> Pixels:
    """Read an input as uint8 [H, W, 3], sRGB, C-contiguous.

    image: the path or bytes of an image file, a Pillow image, or an array: grey [H, W] or [H, W, 1], RGB [H, W, 3] or
    RGBA [H, W, 4], of levels in uint8 or uint16, or floating-point values in [0, 1]; keep_alpha: return [H, W, 4] for a
    transparent picture instead of compositing it over white.
    Warns with ImageWarning of anything dropped. Raises ImageError, and OSError for a path that cannot be read.
    """
    if isinstance(image, str | os.PathLike):
        image = checked_path(image, ImageError).read_bytes()
    if isinstance(image, bytes | bytearray | memoryview):
        return read_image_8_bit(bytes(image), keep_alpha=keep_alpha)
    if isinstance(image, Image.Image):
        return _pixels(lambda: decode(open_pillow(image)), keep_alpha)
    if isinstance(image, np.ndarray):
        return _pixels(lambda: from_array(image), keep_alpha)
    raise ImageError(
        "an image must be a path, the bytes of an image file, a Pillow image or a numpy array, "
        f"not {type(image).__name__}"
    )


def read_image_8_bit(
    data: bytes, limits: ImageLimits | None = None, *, keep_alpha: bool = False, smaller: int = 1
) -> Pixels:
    """Decode an image file by the rules at the top of this module, to uint8 [H, W, 3], sRGB, C-contiguous.

    keep_alpha: return [H, W, 4] for a transparent picture instead of compositing it over white. smaller: a JPEG may be
    decoded at 1/2, 1/4 or 1/8 of its size, but not below 1 / smaller, in a fraction of the time.
    Warns with ImageWarning of anything dropped. Raises ImageError where read_header does, and if pixel data are damaged
    or missing.
    """
    kind, limits = name_of(data), limits or ImageLimits()
    return _pixels(lambda: decode(open_file(data, kind, limits), smaller), keep_alpha, kind)


def _pixels(decoded: Callable[[], Picture], keep_alpha: bool, kind: str = "image") -> Pixels:
    """Take a picture through all steps, from a file, a Pillow image or an array to 8-bit sRGB."""
    with only_image_errors(kind):
        picture = decoded()
        for step in (orient, to_srgb) if keep_alpha else (orient, to_srgb, composite):
            picture = step(picture)
        pixels = round_to_8_bits(picture)
    warn(picture.notes)
    return pixels


def orient(picture: Picture) -> Picture:
    """Undo the EXIF orientation (EXIF 2.32, table 6): flip rows, flip columns, swap the two."""
    rows = slice(None, None, -1 if picture.orientation in (3, 4, 6, 7) else 1)
    columns = slice(None, None, -1 if picture.orientation in (2, 3, 7, 8) else 1)
    axes = (1, 0, 2) if picture.orientation >= 5 else (0, 1, 2)
    alpha = None if picture.alpha is None else picture.alpha[rows, columns].transpose(axes)
    return replace(picture, levels=picture.levels[rows, columns].transpose(axes), alpha=alpha)


def to_srgb(picture: Picture) -> Picture:
    """Convert the colours that the picture states."""
    if picture.colour is None:
        return picture
    levels, white = picture.colour.convert(picture.levels, picture.white)
    return replace(picture, levels=levels, white=white)


def composite(picture: Picture) -> Picture:
    """Composite a transparent picture over white, value * alpha + (1 - alpha), and note it."""
    if picture.alpha is None:
        return picture
    part = _values(picture.alpha, picture.opaque)
    values = _values(picture.levels, picture.white)
    values *= part
    values += 1 - part
    return Picture(values, 1, notes=(*picture.notes, "transparency is composited over white"))


def round_to_8_bits(picture: Picture) -> Pixels:
    """Round to levels 0 to 255, C-contiguous: [H, W, 3], or [H, W, 4] with alpha."""
    height, width = picture.levels.shape[:2]
    pixels = _rounded(np.broadcast_to(picture.levels, (height, width, 3)), picture.white)
    return pixels if picture.alpha is None else np.dstack([pixels, _rounded(picture.alpha, picture.opaque)])


def _values(levels: npt.NDArray[Any], white: int) -> npt.NDArray[np.float32]:
    """Convert levels in [0, white] to float32 in [0, 1]; always a copy."""
    values = levels.astype(np.float32)
    if white != 1:
        values /= white
    return values


def _rounded(levels: npt.NDArray[Any], white: int) -> Pixels:
    """Convert levels in [0, white] to uint8, C-contiguous, row by row to save memory; uint8 is left as it is."""
    if levels.dtype == np.uint8:
        return np.ascontiguousarray(levels, np.uint8)
    pixels = np.empty(levels.shape, np.uint8)
    for row, one in zip(pixels, levels, strict=True):
        row[...] = np.round(_values(one, white) * 255)
    return pixels


@contextmanager
def only_image_errors(kind: str = "image") -> Iterator[None]:
    """Turn everything that Pillow raises on a bad file into ImageError.

    Pillow's warnings take their way: Python's filters, which could silence them, belong to all threads of a program.
    """
    try:
        yield
    except SgError:  # already ours; NativeModuleError comes from ImageLimits, which asks the kernels for MAX_SIDE
        raise
    except Image.DecompressionBombError as error:  # Pillow's own limit, where the caller's is higher
        raise ImageError("the image is too large: Pillow reads at most 178,956,970 pixels") from error
    except MemoryError as error:
        raise ImageError("not enough memory to decode the image") from error
    except Exception as error:
        reason = str(error).strip().split("\n")[0] or type(error).__name__
        raise ImageError(f"the {kind} is damaged, truncated or unsupported ({reason})") from error


def warn(notes: Iterable[str]) -> None:
    """Issue an ImageWarning for each note, attributed to the program that has called this package or Pillow.

    Within errors.noted(), they are added to its list instead.
    """
    if (collected := NOTES.get()) is not None:
        collected += notes
        return
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_code.co_filename.startswith(PACKAGES):
        level, frame = level + 1, frame.f_back
    for note in notes:
        warnings.warn(note, ImageWarning, stacklevel=level)  # skip_file_prefixes needs Python 3.12
