"""Image formats, recognised by their first bytes and read by a class of Pillow or of a plugin.

The classes are called directly, because Image.open would try other formats, treat a JPEG with further pictures as
another format, and apply its own pixel limit through a global and a warning.
"""

from __future__ import annotations

import importlib
import importlib.util
import io
import logging

from PIL import ImageFile
from PIL.JpegImagePlugin import JpegImageFile

from sgmethod.errors import ImageError
from sgmethod.io import chunks
from sgmethod.io.chunks import PNG_MAGIC

MAGICS: dict[str, tuple[bytes, ...]] = {
    "PNG": (PNG_MAGIC,),
    "JPEG": (b"\xff\xd8\xff",),
    "TIFF": (b"II*\0", b"MM\0*", b"II+\0"),
    "BMP": (b"BM",),
    "GIF": (b"GIF87a", b"GIF89a"),
    "QOI": (b"qoif",),
    "JPEG XL": chunks.JPEG_XL_MAGICS,
    "PPM": tuple(b"P%d%c" % (kind, space) for kind in range(1, 7) for space in b" \t\n\r#"),
}
HEIC_BRANDS = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"}
READERS = {
    "PNG": ("PIL.PngImagePlugin", "PngImageFile"),
    "JPEG": (__name__, "JpegReader"),
    "WebP": ("PIL.WebPImagePlugin", "WebPImageFile"),
    "TIFF": ("PIL.TiffImagePlugin", "TiffImageFile"),
    "BMP": ("PIL.BmpImagePlugin", "BmpImageFile"),
    "GIF": ("PIL.GifImagePlugin", "GifImageFile"),
    "AVIF": ("PIL.AvifImagePlugin", "AvifImageFile"),
    "HEIC": ("pillow_heif", "HeifImageFile"),
    "JPEG XL": ("pillow_jxl.JpegXLImagePlugin", "JXLImageFile"),
    "PPM": ("PIL.PpmImagePlugin", "PpmImageFile"),
    "QOI": ("PIL.QoiImagePlugin", "QoiImageFile"),
}
SUFFIXES = {".png", ".apng", ".jpg", ".jpeg", ".jpe", ".jfif", ".webp", ".avif", ".avifs", ".heic", ".heif", ".hif"}
SUFFIXES |= {".tif", ".tiff", ".bmp", ".dib", ".gif", ".jxl", ".ppm", ".pgm", ".pbm", ".pnm", ".qoi"}
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
PLUGINS = {
    "HEIC": "pip install 'sgmethod[heif]'",
    "JPEG XL": "pip install 'sgmethod[jxl]'",
    "AVIF": "pip install 'pillow>=11.3'",
}

# Without a handler, Python prints Pillow's messages about odd files to stderr.
logging.getLogger("PIL").addHandler(logging.NullHandler())


class JpegReader(JpegImageFile):
    """Pillow's reader, except that it leaves out the resolution in EXIF data, of whose damage it would warn."""

    def _read_dpi_from_exif(self) -> None:
        pass


def name_of(data: bytes) -> str:
    """Recognise a file's format, one of READERS. Raises ImageError for any other."""
    for name, magics in MAGICS.items():
        if data.startswith(magics):
            return name
    if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
        return "WebP"
    brands = set(chunks.brands(data))
    if {b"avif", b"avis"} & brands:
        return "AVIF"
    if HEIC_BRANDS & brands:
        return "HEIC"
    if not data:
        raise ImageError("the file is empty")
    kind = next((f"{name}, " for name, magics in REFUSED.items() if data.startswith(magics)), "")
    kind = "a video, " if VIDEO_BRANDS & brands else kind
    raise ImageError(f"the file is {kind}not a {', '.join(list(READERS)[:-1])} or {list(READERS)[-1]} image")


def is_read(first: bytes) -> bool:
    """Whether a file's format can be read, given its first 256 bytes."""
    try:
        return importlib.util.find_spec(READERS[name_of(first)][0]) is not None
    except (ImageError, ModuleNotFoundError):
        return False


def reader_of(name: str) -> type[ImageFile.ImageFile]:
    """Import the class that reads a format. Raises ImageError if its package is missing."""
    module, reader = READERS[name]
    try:
        found: type[ImageFile.ImageFile] = getattr(importlib.import_module(module), reader)
    except ImportError as error:
        raise ImageError(f"reading {name} files needs an extra package: {PLUGINS[name]}") from error
    return found


def open_reader(data: bytes, name: str) -> ImageFile.ImageFile:
    """Open a reader, which parses the header. Raises its errors, and ImageError if its package is missing."""
    return reader_of(name)(io.BytesIO(chunks.plain_png(data) if name == "PNG" else data))
