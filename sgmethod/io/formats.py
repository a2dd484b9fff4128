"""All picture formats, recognised by their first bytes and read by a class of Pillow or of a plugin.

The classes are called directly, because Image.open would try other formats, treat a JPEG with further pictures as
another format, and apply its own pixel limit through a global and a warning.
"""

from __future__ import annotations

import importlib
import importlib.util
import io
import logging
from collections.abc import Iterable

from PIL import ImageFile

from sgmethod.errors import ImageError
from sgmethod.io.chunks import brands
from sgmethod.io.kinds import avif, bmp, gif, heic, jpeg, jpeg_xl, png, ppm, qoi, tiff, webp
from sgmethod.io.kinds.format import Format

ALL: tuple[Format, ...] = tuple(
    kind.FORMAT for kind in (png, jpeg, webp, tiff, bmp, gif, avif, heic, jpeg_xl, ppm, qoi)
)
FORMATS = {one.name: one for one in ALL}
SUFFIXES = {suffix for one in ALL for suffix in one.suffixes}
PLAIN, EXTRA = ([one.name for one in ALL if bool(one.extra) is is_extra] for is_extra in (False, True))
WRITTEN = {one.name: one.writer for one in ALL if one.writer is not None}
# Of picture formats that are not read. No .sg file should have such a name.
OTHER_SUFFIXES = {".jp2", ".j2k", ".jpx", ".psd", ".svg", ".pdf", ".eps", ".exr", ".hdr", ".ico", ".icns", ".tga"}
OTHER_SUFFIXES |= {".dds"}
REFUSED = {
    "an .sg file already": tuple(bytes([0xD3, 0xC0 + version]) for version in range(1, 16)),
    "a big-endian BigTIFF": (b"MM\0+",),
    "a JPEG 2000": (b"\0\0\0\x0cjP  \r\n\x87\n", b"\xff\x4f\xff\x51"),
    "a PDF": (b"%PDF",),
    "a Photoshop file": (b"8BPS",),
    "an SVG": (b"<svg", b"<?xml"),
    "a web page": (b"<!DOCTYPE", b"<html"),
    "an icon": (b"\0\0\1\0",),
}
VIDEO_BRANDS = {b"isom", b"mp41", b"mp42", b"qt  "}

# Without a handler, Python prints Pillow's messages about odd files to stderr.
logging.getLogger("PIL").addHandler(logging.NullHandler())


def listed(names: Iterable[str], conjunction: str = "and") -> str:
    """Join names as prose does: "PNG, JPEG and WebP"."""
    *others, last = names
    return f"{', '.join(others)} {conjunction} {last}" if others else last


def name_of(data: bytes) -> str:
    """Recognise a file's format, one of FORMATS. Raises ImageError for any other."""
    for name, one in FORMATS.items():
        if one.begins(data):
            return name
    if not data:
        raise ImageError("the file is empty")
    kind = next((f"{name}, " for name, magics in REFUSED.items() if data.startswith(magics)), "")
    kind = "a video, " if VIDEO_BRANDS & set(brands(data)) else kind
    raise ImageError(f"the file is {kind}not a {listed(FORMATS, 'or')} image")


def is_read(first: bytes) -> bool:
    """Whether a file's format can be read, given its first 256 bytes."""
    try:
        return importlib.util.find_spec(FORMATS[name_of(first)].reader[0]) is not None
    except (ImageError, ModuleNotFoundError):
        return False


def how_to_install(name: str) -> str:
    """Return the command that installs what reads a format."""
    known = FORMATS[name]
    return f"pip install '{f'sgmethod[{known.extra}]' if known.extra else f'pillow>={known.pillow}'}'"


def reader_of(name: str) -> type[ImageFile.ImageFile]:
    """Import the class that reads a format. Raises ImageError if its package cannot be loaded."""
    module, reader = FORMATS[name].reader
    try:
        found: type[ImageFile.ImageFile] = getattr(importlib.import_module(module), reader)
    except ImportError as error:
        raise ImageError(f"reading {name} files needs a package ({error}): {how_to_install(name)}") from error
    return found


def open_reader(data: bytes, name: str) -> ImageFile.ImageFile:
    """Open a reader, which parses the header. Raises its errors, and ImageError if its package cannot be loaded."""
    return reader_of(name)(io.BytesIO(FORMATS[name].prepared(data)))
