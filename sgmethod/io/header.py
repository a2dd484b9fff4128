"""Image headers: everything known about a picture before decoding its pixels, and all checks up to then."""

from __future__ import annotations

import os
import re
import struct
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from sgmethod.errors import NOTES, ImageError, ImageWarning, SgError
from sgmethod.io import chunks, formats
from sgmethod.io.colour import Colour, ProfileError
from sgmethod.io.levels import BITS_PER_SAMPLE, Box, stated_colour
from sgmethod.io.pillow_defaults import pillow_defaults
from sgmethod.native import native

# TIFF: tags; values of PLANAR and SAMPLE_FORMAT
NEW_SUBFILE_TYPE, ORIENTATION, PLANAR, SAMPLE_FORMAT = 254, 274, 284, 339
SEPARATE, UNSIGNED, UNKNOWN = 2, 1, 4
EXIF_MARKS = re.compile(rb"^(Exif\0\0)*")  # some writers put it there twice
WHOLE_NUMBERS = {1: "B", 3: "H", 4: "I"}  # TIFF's types
PACKAGES = tuple(f"{folder}{os.sep}" for folder in (Path(__file__).parents[1], Path(Image.__file__).parent))
UNSUPPORTED_SAMPLES = "samples of more than 16 bits, signed samples and floats are not supported"


@dataclass(frozen=True)
class ImageHeader:
    """The header of an image file.

    format: one of formats.READERS; width, height: pixels, after EXIF orientation; still: whether it is the only picture
    in the file.
    """

    format: str
    width: int
    height: int
    still: bool = True


@dataclass(frozen=True)
class ImageLimits:
    """Limit on the size of a picture to read. A side never exceeds native.MAX_SIDE, the maximum of .sg and JPEG files.

    max_pixels: width times height. 100 million covers nearly every camera; read_image_8_bit then returns 300 MB and
    needs 2.8 GB while working (RGBA over white, the worst kind measured).
    """

    max_pixels: int = 100_000_000

    def check(self, width: int, height: int) -> None:
        """Raise ImageError if a picture of width x height pixels is empty or too large."""
        if width <= 0 or height <= 0:
            raise ImageError(f"the image is empty: its header says {width} x {height} pixels")
        if max(width, height) > native.MAX_SIDE or width * height > self.max_pixels:
            raise ImageError(
                f"the image is too large: {width} x {height} pixels; the limit is "
                f"{self.max_pixels:,} pixels and {native.MAX_SIDE:,} per side"
            )


@dataclass(frozen=True)
class Opened:
    """A reader that has parsed its header, and everything known about its picture so far."""

    reader: Image.Image
    orientation: int  # EXIF orientation, still to be undone
    colour: Colour
    notes: list[str]  # warnings about dropped parts
    frame: Box | None = None  # the area with pixels, if not the whole picture
    crop: Box | None = None  # the visible area, if not the whole picture

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the visible area, before orientation."""
        x0, y0, x1, y1 = self.crop or (0, 0, *self.reader.size)
        return x1 - x0, y1 - y0


@contextmanager
def only_image_errors(kind: str = "image") -> Iterator[None]:
    """Turn everything that Pillow raises on a bad file into ImageError, and use its defaults.

    Pillow's warnings take their way: Python's filters, which could silence them, belong to all threads of a program.
    """
    try:
        with pillow_defaults():
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


def warn(notes: list[str]) -> None:
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


def open_file(data: bytes, kind: str, limits: ImageLimits | None) -> Opened:
    """Open a file after every check that needs no pixels."""
    jpeg_xl = check_jpeg_xl(data, limits) if kind == "JPEG XL" else None
    try:
        reader = formats.open_reader(data, kind)
    except RuntimeError as error:
        raise ValueError("rejected by its decoder") from error  # the decoder's own message would not help a user
    (limits or ImageLimits()).check(*reader.size)
    notes = [] if is_still(reader, data) else ["only the first of several pictures is used"]
    if kind == "TIFF":
        _check_tiff(reader)
    _check_tiles(reader, kind)
    if jpeg_xl is not None and jpeg_xl.depth > 8 and reader.mode == "LA":
        raise ImageError("grey JPEG XL files with more than 8 bits and alpha are not supported")
    if not (reader.mode == "I" and kind == "PPM"):
        check_mode(reader)
    stated, profile_notes = colour_of(reader, data)
    block = reader.info.get("exif") or (chunks.of_png(data).get(b"eXIf") if kind == "PNG" else None)
    # Pillow's TIFF reader and libheif turn the picture themselves, as does libjxl unless it reconstructs a JPEG.
    turned = kind in ("TIFF", "HEIC") or (jpeg_xl is not None and not getattr(reader, "jpeg", False))
    orientation = 1 if turned else orientation_of(block)
    crop = chunks.clean_aperture(data, *reader.size) if kind == "AVIF" else None  # libheif crops itself
    return Opened(reader, orientation, stated, [*notes, *profile_notes], frame_of(reader), crop)


def check_jpeg_xl(data: bytes, limits: ImageLimits | None) -> chunks.JpegXl:
    """Check a JPEG XL's header first: its reader decodes all pixels on opening, some wrongly. Raises ImageError."""
    formats.reader_of("JPEG XL")
    header = chunks.of_jpeg_xl(data)
    (limits or ImageLimits()).check(header.width, header.height)
    if header.is_animated:
        raise ImageError("animated JPEG XL files are not supported")
    return header


def is_still(reader: Image.Image, data: bytes) -> bool:
    """Whether a file contains only one picture."""
    if reader.format == "TIFF":
        return chunks.holds_one_picture(data)
    return not getattr(reader, "is_animated", False)


def frame_of(reader: Image.Image) -> Box | None:
    """Area of a GIF's first frame; None if it covers the picture, and for other formats."""
    if reader.format != "GIF" or reader.tell() > 0:
        return None
    box: Box = reader.dispose_extent  # type: ignore[attr-defined]
    return None if box == (0, 0, *reader.size) else box


def check_mode(reader: Image.Image) -> None:
    """Raise ImageError for samples of Pillow's 32-bit modes, which do not say which value is white."""
    if reader.mode in ("I", "F"):
        raise ImageError(UNSUPPORTED_SAMPLES)


def _check_tiff(reader: Any) -> None:
    """Raise ImageError on TIFF files that Pillow would read wrongly."""
    tags = reader.tag_v2
    if tags.get(NEW_SUBFILE_TYPE, 0) & 1:
        raise ImageError("the first picture in the file is only a preview, as in camera raw files")
    if not {*tags.get(SAMPLE_FORMAT, ())} <= {UNSIGNED, UNKNOWN}:
        raise ImageError(UNSUPPORTED_SAMPLES)
    if tags.get(PLANAR) == SEPARATE and max(tags.get(BITS_PER_SAMPLE, (1,))) > 8:
        raise ImageError("TIFF files with planar 16-bit channels are not supported")


def _check_tiles(reader: Any, kind: str) -> None:
    """Raise ImageError if the file lacks data for some pixels, which Pillow would leave black."""
    # libtiff checks this itself, Pillow lists no tiles for WebP and HEIC, and a GIF's first frame may be smaller than
    # its screen.
    if kind in ("WebP", "HEIC", "GIF", "JPEG XL") or (reader.tile and reader.tile[0][0] == "libtiff"):
        return
    is_planar = kind == "TIFF" and reader.tag_v2.get(PLANAR) == SEPARATE
    planes = len(reader.getbands()) if is_planar else 1
    boxes = [tile[1] or (0, 0, *reader.size) for tile in reader.tile]
    if sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in boxes) < planes * reader.width * reader.height:
        raise ImageError("the file is missing pixel data")


def colour_of(reader: Image.Image, data: bytes | None) -> tuple[Colour, list[str]]:
    """Return the colours that the file states, and notes on a profile that is ignored."""
    if reader.mode == "LAB":  # defines its colours itself
        return None, []
    grey = reader.mode in ("1", "L", "LA", "I") or reader.mode.startswith("I;16")
    mode = "L" if grey else "CMYK" if reader.mode == "CMYK" else "RGB"
    try:
        return stated_colour(reader, mode, data), []
    except ProfileError as error:
        return None, [f"its colour profile is ignored: {error}"]


def orientation_of(block: object) -> int:
    """EXIF orientation, 1 to 8, from an EXIF block; 1 if there is none.

    Only this entry is parsed: Pillow parses all, and warns of damage that does not matter here.
    """
    tiff = re.sub(EXIF_MARKS, b"", block) if isinstance(block, bytes) else b""
    order = "<" if tiff[:2] == b"II" else ">"
    try:
        (at,) = struct.unpack_from(order + "I", tiff, 4)
        (entries,) = struct.unpack_from(order + "H", tiff, at)
        for place in range(at + 2, at + 2 + 12 * entries, 12):
            tag, kind = struct.unpack_from(order + "HH", tiff, place)
            if tag == ORIENTATION:
                (value,) = struct.unpack_from(order + WHOLE_NUMBERS[kind], tiff, place + 8)
                return value if value in range(1, 9) else 1
    except (struct.error, KeyError):  # damaged EXIF data says nothing about the pixels
        pass
    return 1
