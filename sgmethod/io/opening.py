"""The first step of reading a picture: open it, and check everything that needs no pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from PIL import Image

from sgmethod.errors import ImageError
from sgmethod.io import chunks, colour, formats, items
from sgmethod.io.chunks import Box
from sgmethod.io.colour import Colour, ProfileError
from sgmethod.io.formats import FORMATS
from sgmethod.io.kinds import bmp, png
from sgmethod.io.kinds.format import Format, Header
from sgmethod.native import native

# TIFF: tags, and values of PLANAR and SAMPLE_FORMAT
NEW_SUBFILE_TYPE, BITS_PER_SAMPLE, PLANAR, SAMPLE_FORMAT = 254, 258, 284, 339
THUMBNAIL, SEPARATE, UNSIGNED, UNKNOWN = 1, 2, 1, 4
MAX_PAGES = 100


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
    """A picture whose header is parsed.

    reader: not yet loaded; data: the file, None for a Pillow image; orientation: of EXIF, still to be undone; colour:
    as stated, None for sRGB; notes: warnings about dropped parts; still: whether it is the only picture in the file;
    frame: the part with pixels, that of a GIF's first frame; aperture: the visible part of an AVIF; None if all.
    """

    reader: Image.Image
    data: bytes | None
    orientation: int
    colour: Colour
    notes: tuple[str, ...] = ()
    still: bool = True
    frame: Box | None = None
    aperture: Box | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height before orientation."""
        x0, y0, x1, y1 = self.aperture or (0, 0, *self.reader.size)
        return x1 - x0, y1 - y0


def open_file(data: bytes, kind: str, limits: ImageLimits) -> Opened:
    """Open a file of one of FORMATS after every check that needs no pixels. Raises ImageError, and Pillow's."""
    known, header = FORMATS[kind], check_header(data, kind, limits)
    try:
        reader = formats.open_reader(data, kind)
    except RuntimeError as error:
        raise ValueError("rejected by its decoder") from error  # the decoder's own message would not help a user
    limits.check(*reader.size)
    if kind == "TIFF" and _is_thumbnail(reader):
        raise ImageError("the first picture in the file is only a thumbnail, as in camera raw files")
    check_samples(reader)
    _check_tiles(reader, known)
    if header is not None and header.depth > 8 and reader.mode == "LA":
        raise ImageError(f"grey {kind} files with more than 8 bits and alpha are not supported")
    exif = reader.info.get("exif") or (png.png_chunks(data).get(b"eXIf") if kind == "PNG" else None)
    turned = known.turns and not getattr(reader, "jpeg", False)  # libjxl does not turn a JPEG that it reconstructs
    orientation = 1 if turned else chunks.exif_orientation(exif)
    stated, notes = stated_colour(reader, data)
    still = _is_still(reader, data)
    if not still:
        notes = ("only the first of several pictures is used", *notes)
    aperture = items.clean_aperture(data, *reader.size) if kind == "AVIF" else None  # libheif crops itself
    return Opened(reader, data, orientation, stated, notes, still, frame_of(reader), aperture)


def open_pillow(image: Image.Image) -> Opened:
    """Check a Pillow image as a file is checked, and copy it."""
    ImageLimits().check(*image.size)
    check_samples(image)
    tags, frame, image = getattr(image, "tag_v2", None), frame_of(image), image.copy()
    if tags is not None:  # a copy has lost those of TIFF, which say what white is
        image.tag_v2 = tags  # type: ignore[attr-defined]
    orientation = chunks.exif_orientation(image.info.get("exif"))
    return Opened(image, None, orientation, *stated_colour(image, None), frame=frame)


def check_header(data: bytes, kind: str, limits: ImageLimits) -> Header | None:
    """Check the header before a reader that decodes all pixels on opening; None for others. Raises ImageError."""
    header_of = FORMATS[kind].header
    if header_of is None:
        return None
    formats.reader_of(kind)
    header = header_of(data)
    limits.check(header.width, header.height)
    if header.is_animated:
        raise ImageError(f"animated {kind} files are not supported")
    return header


def check_samples(reader: Any) -> None:
    """Raise ImageError for samples that Pillow would read wrongly, or of which it does not know what is white."""
    tags = getattr(reader, "tag_v2", {})  # of a TIFF
    is_wide = reader.mode == "F" or (reader.mode == "I" and reader.format != "PPM")
    if is_wide or not {*tags.get(SAMPLE_FORMAT, ())} <= {UNSIGNED, UNKNOWN}:
        raise ImageError("samples of more than 16 bits, signed samples and floats are not supported")
    if tags.get(PLANAR) == SEPARATE and max(tags.get(BITS_PER_SAMPLE, (1,))) > 8:
        raise ImageError("TIFF files with planar 16-bit channels are not supported")


def _is_thumbnail(tiff: Any) -> bool:
    """Whether the page that a reader is at is a thumbnail of another."""
    return bool(tiff.tag_v2.get(NEW_SUBFILE_TYPE, 0) & THUMBNAIL)


def _check_tiles(reader: Any, known: Format) -> None:
    """Raise ImageError if the file lacks data for some pixels, which Pillow would leave black."""
    if not known.lists_tiles or (reader.tile and reader.tile[0][0] == "libtiff"):  # which checks this itself
        return
    is_planar = known.name == "TIFF" and reader.tag_v2.get(PLANAR) == SEPARATE
    planes = len(reader.getbands()) if is_planar else 1
    boxes = [tile[1] or (0, 0, *reader.size) for tile in reader.tile]
    if sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in boxes) < planes * reader.width * reader.height:
        raise ImageError("the file is missing pixel data")


def _is_still(reader: Image.Image, data: bytes) -> bool:
    """Whether a file contains only one picture. A TIFF's thumbnails do not count, nor pages that Pillow cannot read."""
    if not getattr(reader, "is_animated", False):
        return True
    if reader.format != "TIFF":
        return False
    pages: Any = formats.open_reader(data, "TIFF")
    try:
        for page in range(1, MAX_PAGES):
            pages.seek(page)
            if not _is_thumbnail(pages):
                return False
    except Exception:  # there are no more pages, or they are damaged
        return True
    return False


def frame_of(reader: Any) -> Box | None:
    """Part of the picture that a GIF's first frame covers; None for other formats, and for later frames."""
    return reader.dispose_extent if reader.format == "GIF" and reader.tell() == 0 else None


def stated_colour(reader: Image.Image, data: bytes | None) -> tuple[Colour, tuple[str, ...]]:
    """Colours of the decoded samples, and a note if their statement is ignored. Raises ImageError for PQ and HLG.

    The most exact statement counts (PNG, third edition, 4.3).
    """
    if reader.mode == "LAB":  # defines its colours itself
        return None, ()
    is_grey = reader.mode in ("1", "L", "LA", "I") or reader.mode.startswith("I;16")
    mode = "L" if is_grey else "CMYK" if reader.mode == "CMYK" else "RGB"
    info, kind = reader.info, reader.format if data is not None else None
    chunks_of_png = png.png_chunks(data) if data is not None and kind == "PNG" else {}
    found: Colour = None
    try:
        if len(cicp := chunks_of_png.get(b"cICP", b"")) == 4:
            found = colour.from_code_points(cicp[0], cicp[1])
        elif b"iCCP" in chunks_of_png:
            found = colour.from_profile(colour.inflate(chunks_of_png[b"iCCP"]), mode)
        elif "icc_profile" in info:
            found = colour.from_profile(info["icc_profile"] or b"", mode)
        elif data is not None and kind == "BMP" and (profile := bmp.bmp_profile(data)) is not None:
            found = colour.from_profile(profile, mode)
        elif data is not None and kind == "AVIF" and (points := items.code_points(data)) is not None:
            found = colour.from_code_points(*points)
        elif nclx := info.get("nclx_profile"):  # of pillow_heif
            found = colour.from_code_points(nclx["color_primaries"], nclx["transfer_characteristics"])
        elif info.get("srgb") is None:  # a Pillow image opened from a PNG still has its sRGB, gAMA and cHRM
            found = colour.from_gamma(info)
    except ProfileError as error:
        return None, (f"its colour profile is ignored: {error}",)
    return found, ()
