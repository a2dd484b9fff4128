"""Picture files: the query parameters of a picture, the part of a bitstream they select, and fast encoders."""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

import sgmethod
from sgmethod.errors import ViewError
from sgmethod.io import pictures
from sgmethod.io.formats import WRITTEN, listed
from sgmethod.io.within import last_within
from sgmethod.view import MAX_SCALE, MIN_SCALE, View, fitted_scale

# The formats that browsers show, by their suffix without the dot.
WRITERS = {writer.suffixes[0][1:]: writer for writer in WRITTEN.values() if writer.media_type}
MEDIA_TYPES = {kind: str(writer.media_type) for kind, writer in WRITERS.items()}
if TYPE_CHECKING:
    PictureFormat = str
else:
    PictureFormat = Literal[tuple(WRITERS)]
ComparisonFormat = Literal["jpg", "webp", "avif"]
LOSSY = listed((kind for kind, writer in WRITERS.items() if writer.quality), "or")
# Without a colour profile, which would be a tenth of a small file.
COMPARISONS: dict[ComparisonFormat, tuple[str, dict[str, Any]]] = {
    "jpg": ("JPEG", {"optimize": True}),
    "webp": ("WEBP", {}),
    "avif": ("AVIF", {"max_threads": 1}),
}
# Seven AVIF files take 3.3 or 0.9 s of a core for 0.37 megapixels at these speeds.
AVIF_SPEED, FAST_AVIF_SPEED = 6, 8
SLOW_AVIF_PIXELS = 600_000  # up to which the slower speed is used
MAX_COMPARED_PIXELS = 3_000_000  # so that a search stays within a request's time
NEAR = 0.03  # files whose sizes differ by no more than this share count as equally large
PNG_LEVEL = 1

Pixels = NDArray[np.uint8]
Fit = Literal["contain", "cover", "crop"]
Region = tuple[int, int, int, int]
REGION = r"^[0-9]{1,5},[0-9]{1,5},[0-9]{1,5},[0-9]{1,5}$"
Side = Annotated[int | None, Field(ge=1, le=65_535, description="output size in pixels, instead of scale")]


def encode_picture(pixels: Pixels, kind: PictureFormat, quality: int | None = None) -> bytes:
    """Encode pixels, uint8 [H, W, 3], as a picture file. quality: 1 to 100. Raises ImageError for too long a side."""
    options = {**WRITERS[kind].quick, "quality": quality or WRITERS[kind].quality}
    return pictures.picture_file(
        pixels, pictures.SUFFIXES[f".{kind}"], options, lambda rows: isal_zlib.compress(rows, PNG_LEVEL)
    )


def as_large(encoded: Callable[[int], bytes], size: int) -> bytes:
    """Search all qualities for the largest file of at most `size` bytes, or the next larger one if it is not NEAR."""
    encoded = cache(encoded)
    last = last_within(lambda quality: len(encoded(quality)), size, 0, 101)
    under, over = (encoded(quality) if 1 <= quality <= 100 else b"" for quality in (last, last + 1))
    return under if under and (not over or len(under) >= (1 - NEAR) * size) else over


def comparison_file(pixels: Pixels, kind: ComparisonFormat, size: int, *, drawn: bool = False) -> bytes:
    """Encode pixels, uint8 [H, W, 3], by another codec to about `size` bytes.

    drawn: the image is a drawing, whose sharp colour edges AVIF keeps without chroma subsampling.
    """
    from PIL import Image  # the web process, which imports this module, never encodes

    name, options = COMPARISONS[kind]
    if kind == "avif":
        is_small = pixels.shape[0] * pixels.shape[1] <= SLOW_AVIF_PIXELS
        speed, sampling = AVIF_SPEED if is_small else FAST_AVIF_SPEED, "4:4:4" if drawn else "4:2:0"
        options = {**options, "speed": speed, "subsampling": sampling}

    def encoded(quality: int) -> bytes:
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, name, quality=quality, **options)
        return file.getvalue()

    return as_large(encoded, size)


class PictureOptions(BaseModel):
    """The part of a picture to draw, and its size: in the query of a request, and in a task."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    scale: Annotated[float | None, Field(ge=MIN_SCALE, le=MAX_SCALE, description="output pixels per pixel")] = None
    width: Side = None
    height: Side = None
    fit: Annotated[
        Fit, Field(description="with width and height: fit inside them, cover them, or crop to them from the centre")
    ] = "contain"
    region: Annotated[
        str | None,
        Field(
            json_schema_extra={"pattern": REGION},
            description="x,y,width,height: decode only this part, in pixels of the picture",
            examples=["0,0,8,8"],
        ),
    ] = None
    prefix: Annotated[float, Field(gt=0, le=1, description="fraction of the file to decode; less is coarser")] = 1.0
    texture: Annotated[bool, Field(description="draw the file's synthesised texture")] = True
    quality: Annotated[int | None, Field(ge=1, le=100, description=f"quality of a {LOSSY} file")] = None

    @field_validator("region")
    @classmethod
    def _region_is_four_numbers(cls, text: str | None) -> str | None:
        if text is not None and re.fullmatch(REGION, text) is None:  # Field(pattern=...) would answer with the pattern
            raise ValueError("give four whole numbers of pixels: x,y,width,height")
        return text

    @model_validator(mode="after")
    def _fits_together(self) -> PictureOptions:
        if self.scale is not None and (self.width, self.height) != (None, None):
            raise ValueError("use either scale or width and height, not both")
        if self.fit != "contain" and None in (self.width, self.height):
            raise ValueError(f"fit={self.fit} needs both width and height")
        return self


@dataclass(frozen=True)
class Drawing:
    """A picture file to draw: the view, and the width and height in pixels to crop it to."""

    kind: PictureFormat
    view: View
    width: int
    height: int
    quality: int | None

    @classmethod
    def from_options(
        cls, options: PictureOptions, kind: PictureFormat, size: tuple[int, int], max_pixels: int
    ) -> Drawing:
        """Apply the options to a picture of this size (width, height).

        Raises ViewError if the result is empty, or exceeds max_pixels or the limits of the file format.
        """
        writer = WRITERS[kind]
        if options.quality is not None and writer.quality is None:
            raise ViewError(f"quality does not apply to {kind} files")
        part = View(1.0, _region(options)).area(*size)
        scale, box = options.scale or 1.0, (options.width, options.height)
        ratios = [want / have for want, have in zip(box, part[2:], strict=True) if want is not None]
        if ratios:
            scale = fitted_scale(min(ratios) if options.fit == "contain" else max(ratios), part[2], part[3])
        crop = box if options.fit == "crop" else (None, None)
        if crop[0] is not None and crop[1] is not None:
            part = _middle(part, crop[0] / scale, crop[1] / scale)
        view = View(scale, None if part == (0, 0, *size) else part, options.prefix, options.texture)
        width, height = view.size(*size)
        if width * height > max_pixels or max(width, height) > writer.max_side:
            limit = f"{max_pixels:,} pixels and {writer.max_side:,} per side"
            raise ViewError(f"{width} x {height} pixels exceed the limit of {limit}")
        quality = options.quality or writer.quality
        return cls(kind, view, min(width, crop[0] or width), min(height, crop[1] or height), quality)

    def etag(self, sha256: str) -> str:
        """Return an entity tag: the same bitstream and drawing give the same bytes."""
        return f'"{hashlib.sha256(f"{sha256} {self}".encode()).hexdigest()[:32]}"'

    def draw(self, bitstream: bytes) -> bytes:
        """Return the picture file. Raises BitstreamError, ViewError, MemoryError."""
        return encode_picture(self._cropped(sgmethod.decode(bitstream, view=self.view)), self.kind, self.quality)

    def _cropped(self, pixels: Pixels) -> Pixels:
        y, x = ((have - want) // 2 for have, want in zip(pixels.shape, (self.height, self.width), strict=False))
        return np.ascontiguousarray(pixels[y : y + self.height, x : x + self.width])


def _region(options: PictureOptions) -> Region | None:
    if options.region is None:
        return None
    x, y, width, height = map(int, options.region.split(","))
    return x, y, width, height


def _middle(part: Region, width: float, height: float) -> Region:
    """Return the middle of a part, in whole pixels, at least this wide and high."""
    x, y, w, h = part
    left, top = max(int((w - width) / 2), 0), max(int((h - height) / 2), 0)
    return x + left, y + top, w - 2 * left, h - 2 * top
