"""Image files to arrays.

read_header looks at a file without decoding a pixel of it; read_image decodes it. The same rules hold for
both, and whatever they refuse is an ImageError with one clear sentence:

    formats        PNG, JPEG, WebP, TIFF and BMP, known by their first bytes, never by a file name
    size           checked against ImageLimits from the header, before pixels are decoded
    frames         exactly one; animations and files of several pages are refused, because taking the first
                   would lose the others silently. A JPEG with pictures behind its own (a preview, a gain map)
                   is one picture.
    whole          a file that is cut short or leaves pixels unset is refused, as is a PNG with any damage;
                   damage inside other formats can go unseen, because they carry no checksum
    orientation    the EXIF orientation is applied; EXIF data that cannot be parsed counts as absent
    colour         values are taken as stored and read as sRGB: ICC profiles and gamma chunks are ignored.
                   Grey becomes three equal channels, palettes are expanded, CMYK, YCbCr and LAB are converted
                   by Pillow's plain formulas.
    depth          16-bit grey and 16-bit RGB(A) keep all their bits; rarer 16-bit kinds (grey with alpha,
                   premultiplied alpha, CMYK) keep the upper 8. Floats and integers beyond 16 bits are
                   refused, because they do not say which value is white.
    transparency   composited over white, in the values as stored: value * alpha + (1 - alpha)
"""

from __future__ import annotations

import io
import logging
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageFile
from PIL.BmpImagePlugin import BmpImageFile
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.TiffImagePlugin import TiffImageFile
from PIL.WebPImagePlugin import WebPImageFile

from sgmethod.errors import ImageError, SgError
from sgmethod.native import native

Float32Array = npt.NDArray[np.float32]
Uint8Array = npt.NDArray[np.uint8]
Levels = npt.NDArray[np.integer[Any]]
Values = TypeVar("Values", Float32Array, Uint8Array)

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
TIFF_MAGICS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")

# TIFF tags, and two of their values
NEW_SUBFILE_TYPE, BITS_PER_SAMPLE, PHOTOMETRIC, ORIENTATION, PLANAR = 254, 258, 262, 274, 284
WHITE_IS_ZERO, APART = 0, 2

# Pillow's classes are called directly: Image.open would try its other formats, follow a JPEG into its second
# picture, and apply a pixel limit of its own through a global and a warning.
_READERS: dict[str, type[ImageFile.ImageFile]] = {
    "PNG": PngImageFile,
    "JPEG": JpegImageFile,
    "WebP": WebPImageFile,
    "TIFF": TiffImageFile,
    "BMP": BmpImageFile,
}

# Without a handler Python prints what Pillow logs about odd files to stderr.
logging.getLogger("PIL").addHandler(logging.NullHandler())
_PILLOW_LOCK = threading.Lock()  # Python's warning filters, silenced below, are one state for all threads


@dataclass(frozen=True)
class ImageHeader:
    """What a file says of its picture.

    format: "PNG", "JPEG", "WebP", "TIFF" or "BMP"; width, height: pixels, after EXIF orientation;
    frames: always 1, as files with more are refused; mode: Pillow's name of the stored samples, such as
    "RGB" (8 or 16 bits each), "RGBA", "L", "P", "CMYK" or "I;16".
    """

    format: str
    width: int
    height: int
    frames: int
    mode: str


@dataclass(frozen=True)
class ImageLimits:
    """The largest picture that is read.

    max_pixels: width times height. 100 million covers nearly every camera; read_image then returns 1.2 GB
    and needs 2.3 times that while it works (RGBA, the worst kind measured).
    max_side: pixels of the longer side. The default is what an .sg file has room for; JPEG allows no more.
    """

    max_pixels: int = 100_000_000
    max_side: int = field(default_factory=lambda: native.MAX_SIDE)

    def check(self, width: int, height: int) -> None:
        """Raise ImageError if a picture of width x height pixels is empty or too large."""
        if width <= 0 or height <= 0:
            raise ImageError(f"the image is empty: its header says {width} x {height} pixels")
        if max(width, height) > self.max_side or width * height > self.max_pixels:
            raise ImageError(
                f"the image is too large: {width} x {height} pixels, where at most "
                f"{self.max_pixels:,} in all and {self.max_side:,} a side are read"
            )


def read_header(data: bytes, limits: ImageLimits | None = None) -> ImageHeader:
    """The header of an image file, read without decoding pixels.

    Raises ImageError if data is none of the five formats, has a damaged header, more than one frame, samples
    of an unknown range, or a size of zero or beyond limits. A file that passes can still have damaged pixels.
    """
    with _only_image_errors():
        return _open(data, limits or ImageLimits())[1]


def read_image(data: bytes, limits: ImageLimits | None = None) -> Float32Array:
    """Decode an image file by the rules at the top of this module.

    Returns float32 [H, W, 3] in [0, 1], sRGB values as stored, C-contiguous.
    Raises ImageError where read_header does, and if pixel data are damaged or missing.
    """
    levels, peak, orientation = _read_levels(data, limits)
    return _turn(_over_white(_samples(levels, peak)), orientation)


def read_image_8_bit(data: bytes, limits: ImageLimits | None = None) -> Uint8Array:
    """The same picture, uint8 [H, W, 3]: all that an encode uses of it, in a quarter of the memory.

    Samples of more bits, and mixtures with white, are rounded.
    """
    levels, peak, orientation = _read_levels(data, limits)
    if peak == 255 and levels.shape[2] in (1, 3):
        return _turn(_three_channels(levels.astype(np.uint8, copy=False)), orientation)
    return _turn(to_8_bit(_over_white(_samples(levels, peak))), orientation)


def to_8_bit(pixels: npt.NDArray[np.floating[Any]] | Uint8Array) -> Uint8Array:
    """Values in [0, 1] as levels 0 to 255, C-contiguous. Row by row: whole pictures take enough memory as they are."""
    if pixels.dtype == np.uint8:
        return np.ascontiguousarray(pixels, np.uint8)
    levels = np.empty(pixels.shape, np.uint8)
    for row, values in zip(levels, pixels, strict=True):
        row[...] = np.round(values.astype(np.float32, copy=False) * 255)
    return levels


@contextmanager
def _only_image_errors() -> Iterator[None]:
    """Everything that Pillow raises on a bad file leaves as ImageError, and its warnings are not shown."""
    with _PILLOW_LOCK, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            yield
        except SgError:  # one of ours already; or the kernels are missing, which have the largest side
            raise
        except Image.DecompressionBombError as error:  # Pillow's own limit, for callers who allow more
            raise ImageError("the image is too large: Pillow reads at most 178,956,970 pixels") from error
        except MemoryError as error:
            raise ImageError("there is not enough memory to decode the image") from error
        except Exception as error:
            reason = str(error).strip().split("\n")[0] or type(error).__name__
            raise ImageError(f"the image is damaged, cut short or of an unsupported kind ({reason})") from error


def _open(data: bytes, limits: ImageLimits) -> tuple[ImageFile.ImageFile, ImageHeader]:
    """A reader that has parsed the header of data, and the header, after every check that needs no pixels."""
    kind = _format(data)
    reader = _READERS[kind](io.BytesIO(data))
    limits.check(*reader.size)
    if getattr(reader, "is_animated", False):
        raise ImageError("the file holds more than one picture; one still picture is needed")
    if isinstance(reader, TiffImageFile):
        _check_tiff(reader)
    _check_tiles(reader)
    if reader.mode in ("I", "F"):
        raise ImageError("samples of more than 16 bits, signed samples and floats are not supported")
    width, height = reader.size
    if not isinstance(reader, TiffImageFile) and _orientation(reader, data) >= 5:
        width, height = height, width
    return reader, ImageHeader(kind, width, height, frames=1, mode=reader.mode)


def _format(data: bytes) -> str:
    if data.startswith(PNG_MAGIC):
        return "PNG"
    if data.startswith(b"\xff\xd8\xff"):
        return "JPEG"
    if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
        return "WebP"
    if data.startswith(TIFF_MAGICS):
        return "TIFF"
    if data.startswith(b"BM"):
        return "BMP"
    raise ImageError("the file is not a PNG, JPEG, WebP, TIFF or BMP image" if data else "the file is empty")


def _check_tiff(reader: TiffImageFile) -> None:
    """Raise ImageError on TIFF files that Pillow would read, but not as the picture they hold."""
    tags = reader.tag_v2
    if tags.get(NEW_SUBFILE_TYPE, 0) & 1:
        raise ImageError("the first picture of the file is only a preview, as in a camera's raw file")
    if tags.get(PLANAR) == APART and max(tags.get(BITS_PER_SAMPLE, (1,))) > 8:
        raise ImageError("TIFF files with 16-bit channels stored apart are not supported")


def _check_tiles(reader: ImageFile.ImageFile) -> None:
    """Raise ImageError if the file has data for some of its pixels only; Pillow leaves the others black."""
    # Pillow hands a compressed TIFF to libtiff, which checks this, and lists no tiles for a WebP.
    if isinstance(reader, WebPImageFile) or (reader.tile and reader.tile[0][0] == "libtiff"):
        return
    apart = isinstance(reader, TiffImageFile) and reader.tag_v2.get(PLANAR) == APART
    planes = len(reader.getbands()) if apart else 1
    boxes = [tile[1] or (0, 0, *reader.size) for tile in reader.tile]
    if sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in boxes) < planes * reader.width * reader.height:
        raise ImageError("the file does not hold all of its pixels")


def _orientation(reader: ImageFile.ImageFile, data: bytes) -> int:
    """EXIF orientation, 1 to 8; 1 where there is none. Never decodes pixels."""
    block = reader.info.get("exif")
    if block is None and isinstance(reader, PngImageFile):
        block = _exif_of_png(data)
    if not block:
        return 1
    exif = Image.Exif()
    try:
        exif.load(block)
        value = exif.get(ORIENTATION, 1)
    except Exception:  # the pixels are none the worse for it
        return 1
    return value if value in range(1, 9) else 1


def _exif_of_png(data: bytes) -> bytes | None:
    """The eXIf chunk, which may stand behind the pixels, where Pillow finds it only by decoding them."""
    at = len(PNG_MAGIC)
    while at + 8 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        if data[at + 4 : at + 8] == b"eXIf":
            return data[at + 8 : at + 8 + length]
        at += length + 12
    return None


def _read_levels(data: bytes, limits: ImageLimits | None) -> tuple[Levels, int, int]:
    """Decode: levels [H, W, C], the one that is white, and the orientation that is still to be undone."""
    with _only_image_errors():
        reader, _ = _open(data, limits or ImageLimits())
        orientation = _orientation(reader, data)
        levels, peak = _levels(reader, data)
        if isinstance(reader, PngImageFile):
            PngImageFile(io.BytesIO(data)).verify()  # all checksums; decoding skips those of the pixels
    # Pillow's TIFF reader has already turned the picture.
    return levels, peak, 1 if isinstance(reader, TiffImageFile) else orientation


def _levels(reader: ImageFile.ImageFile, data: bytes) -> tuple[Levels, int]:
    """Levels [H, W, C], and the one that is white; C is 1 for grey, 3 for RGB, and one more with alpha."""
    key = reader.info.pop("transparency", None) if reader.mode != "P" else None
    peak = 65535
    if _rawmode(reader)[:-1] in ("RGB;16", "RGBA;16", "RGBX;16"):
        levels = _load_16_bit_rgb(reader, data)
    elif reader.mode.startswith("I;16"):
        levels = _load(reader)[..., None]
        if isinstance(reader, TiffImageFile):
            peak = (1 << reader.tag_v2[BITS_PER_SAMPLE][0]) - 1  # 12 bits are stored as they are
            levels = peak - levels if reader.tag_v2.get(PHOTOMETRIC, 0) == WHITE_IS_ZERO else levels
    else:
        levels, peak = _load_8_bit(reader), 255
    if key is not None:
        # A PNG file's transparent colour. Samples of 2 and 4 bits have been stretched to 8, but not the key.
        opaque = np.any(levels != np.multiply(key, {2: 85, 4: 17}.get(data[24], 1)), axis=2)
        levels = np.dstack([levels, opaque * levels.dtype.type(peak)])
    return levels, peak


def _samples(levels: Levels, peak: int) -> Float32Array:
    """Float32 in [0, 1]."""
    samples = levels.astype(np.float32)
    samples /= peak
    return samples


def _rawmode(reader: ImageFile.ImageFile) -> str:
    """Pillow's name for the order of bits and bytes in the file, "" where it is known only later."""
    arguments = reader.tile[0][3] if reader.tile else ""
    return arguments if isinstance(arguments, str) else str(arguments[0]) if arguments else ""


def _load(reader: ImageFile.ImageFile, mode: str | None = None) -> Levels:
    """Decode, and convert to another of Pillow's modes if asked to."""
    # Pillow's TIFF reader would take the orientation from XMP where the tag is missing: another rule, and
    # another size, than the header's.
    reader.info.pop("xmp", None)
    reader.load()
    return np.asarray(reader.convert(mode) if mode else reader)


def _load_8_bit(reader: ImageFile.ImageFile) -> Levels:
    """uint8 [H, W, 1 or 3 or 4]."""
    if reader.has_transparency_data:
        return _load(reader, "RGBA")
    return _load(reader, "L")[..., None] if reader.mode in ("1", "L") else _load(reader, "RGB")


def _load_16_bit_rgb(reader: ImageFile.ImageFile, data: bytes) -> Levels:
    """uint16 [H, W, 3 or 4].

    Pillow keeps only the upper byte of each sample. Reading a second time with the two bytes named in the
    opposite order makes it keep the lower one.
    """
    opposite = {"L": "B", "B": "L", "N": "B" if sys.byteorder == "little" else "L"}
    rawmode = _rawmode(reader)
    swapped = rawmode[:-1] + opposite[rawmode[-1]]
    lower = type(reader)(io.BytesIO(data))
    lower.tile = [
        tile._replace(args=swapped if isinstance(tile.args, str) else (swapped, *(tile.args or ())[1:]))
        for tile in lower.tile
    ]
    return _load(reader).astype(np.uint16) << 8 | _load(lower)


def _over_white(samples: Float32Array) -> Float32Array:
    """[H, W, C] with or without alpha -> [H, W, 3]."""
    if samples.shape[2] in (2, 4):
        colour, alpha = samples[..., :-1], samples[..., -1:]
        colour *= alpha
        colour += 1 - alpha
        samples = colour
    return _three_channels(samples)


def _three_channels(values: Values) -> Values:
    """[H, W, 1 or 3] -> [H, W, 3]."""
    return np.ascontiguousarray(np.broadcast_to(values, (*values.shape[:2], 3)))


def _turn(pixels: Values, orientation: int) -> Values:
    """Undo an EXIF orientation (EXIF 2.32, table 6): flip rows, flip columns, swap the two."""
    if orientation in (3, 4, 6, 7):
        pixels = pixels[::-1]
    if orientation in (2, 3, 7, 8):
        pixels = pixels[:, ::-1]
    if orientation >= 5:
        pixels = pixels.swapaxes(0, 1)
    return np.ascontiguousarray(pixels)
