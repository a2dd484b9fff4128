"""What a file is that is no picture we read, told by its first bytes, so that the refusal can name it."""

from __future__ import annotations

from sgmethod.io.image import PNG_MAGIC, TIFF_MAGICS

MAGIC_BYTES = 64
READ_FORMATS = "PNG, JPEG, WebP, TIFF and BMP are read"
IMAGE_MAGICS = (PNG_MAGIC, b"\xff\xd8\xff", b"RIFF", *TIFF_MAGICS, b"BM")

_FOREIGN = {
    b"GIF8": "a GIF",
    b"\xff\x0a": "a JPEG XL",
    b"\0\0\0\x0cJXL ": "a JPEG XL",
    b"\0\0\0\x0cjP  ": "a JPEG 2000",
    b"\xff\x4f\xff\x51": "a JPEG 2000",
    b"8BPS": "a Photoshop file",
    b"%PDF": "a PDF",
    b"qoif": "a QOI",
    b"SGM": "an .sg file already",
    b"<svg": "an SVG",
    b"<?xml": "XML, perhaps an SVG",
    b"<!DOCTYPE": "a web page",
    b"<html": "a web page",
    b"\0\0\1\0": "an icon",
}
_BRANDS = {
    b"avif": "an AVIF",
    b"avis": "an AVIF",
    b"heic": "a HEIC",
    b"heix": "a HEIC",
    b"hevc": "a HEIC",
    b"heim": "a HEIC",
    b"mif1": "a HEIF",
    b"msf1": "a HEIF",
    b"crx ": "a Canon raw file",
    b"isom": "a film",
    b"mp42": "a film",
    b"qt  ": "a film",
}


def foreign_format(first: bytes) -> str | None:
    """What the first MAGIC_BYTES say that the file is, with its article; None if they say nothing."""
    if first[4:8] == b"ftyp":
        # A file of several brands, such as an AVIF that is a HEIF too, is named by the one that says most.
        brands = [first[at : at + 4] for at in range(8, len(first) - 3, 4) if at != 12]
        return next((name for brand, name in _BRANDS.items() if brand in brands), "a file of an unknown kind")
    return next((name for magic, name in _FOREIGN.items() if first.startswith(magic)), None)
