"""Which picture file is to be made of a bitstream."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

import sgmethod
from service.sandbox.picture_files import DEFAULT_QUALITY, MAX_SIDES, PictureFormat, Pixels, encode_picture
from sgmethod.errors import ViewError
from sgmethod.view import View

Fit = Literal["contain", "cover", "crop"]
Region = tuple[int, int, int, int]


@dataclass(frozen=True)
class Wish:
    """What a client asks for, before the size of the picture is known.

    kind: of file; scale: output pixels for a pixel; width, height: of the output, in pixels; fit: where both are given,
    whether the picture stays within them, covers them, or is cropped to them around its middle; region: x, y, width and
    height of the part that is drawn, in pixels of the picture; prefix: part of the file that may be used; texture:
    whether it is drawn; quality: of the file, 1 to 100.
    """

    kind: PictureFormat = "png"
    scale: float | None = None
    width: int | None = None
    height: int | None = None
    fit: Fit = "contain"
    region: Region | None = None
    prefix: float = 1.0
    texture: bool = True
    quality: int | None = None

    def __post_init__(self) -> None:
        if self.scale is not None and (self.width, self.height) != (None, None):
            raise ViewError("use either scale or width and height, not both")
        if self.fit != "contain" and None in (self.width, self.height):
            raise ViewError(f"fit={self.fit} needs both width and height")
        if self.quality is not None and self.kind not in DEFAULT_QUALITY:
            raise ViewError(f"quality does not apply to {self.kind} files")


@dataclass(frozen=True)
class Drawing:
    """One picture file to make: the view that is drawn, and the width and height in pixels that are kept of it."""

    kind: PictureFormat
    view: View
    width: int
    height: int
    quality: int | None

    @classmethod
    def of(cls, wish: Wish, size: tuple[int, int], max_pixels: int) -> Drawing:
        """What the wish comes to for a picture of that size (width, height).

        Raises ViewError if that is no picture, or one beyond max_pixels or what the kind of file holds.
        """
        part = View(1.0, wish.region).area(*size)
        scale = wish.scale or 1.0
        wanted = (wish.width, wish.height)
        ratios = [want / have for want, have in zip(wanted, part[2:], strict=True) if want is not None]
        if ratios:
            scale = min(ratios) if wish.fit == "contain" else max(ratios)
        crop = (wish.width, wish.height) if wish.fit == "crop" else (None, None)
        if crop[0] is not None and crop[1] is not None:
            part = _middle(part, crop[0] / scale, crop[1] / scale)
        view = View(scale, None if part == (0, 0, *size) else part, wish.prefix, wish.texture)
        width, height = view.size(*size)
        if width * height > max_pixels or max(width, height) > MAX_SIDES[wish.kind]:
            limit = f"{max_pixels:,} pixels and {MAX_SIDES[wish.kind]:,} per side"
            raise ViewError(f"{width} x {height} pixels exceed the limit of {limit}")
        return cls(
            wish.kind,
            view,
            min(width, crop[0] or width),
            min(height, crop[1] or height),
            wish.quality or DEFAULT_QUALITY.get(wish.kind),
        )

    def etag(self, sha256: str) -> str:
        """An entity tag: the same bitstream and the same drawing give the same bytes."""
        part = "".join(f"{number}-" for number in self.view.region or ())
        prefix = "" if self.view.prefix == 1 else f"p{self.view.prefix!r}-"
        smooth = "" if self.view.texture else "smooth-"
        quality = "" if self.quality is None else f"-q{self.quality}"
        return f'"{sha256[:32]}-{prefix}{smooth}{part}{self.width}x{self.height}{quality}.{self.kind}"'

    def draw(self, bitstream: bytes) -> bytes:
        """The picture file. Raises BitstreamError, ViewError, MemoryError."""
        return encode_picture(self._kept(sgmethod.decode(bitstream, view=self.view)), self.kind, self.quality)

    def _kept(self, pixels: Pixels) -> Pixels:
        y, x = ((have - want) // 2 for have, want in zip(pixels.shape, (self.height, self.width), strict=False))
        return np.ascontiguousarray(pixels[y : y + self.height, x : x + self.width])


def _middle(part: Region, width: float, height: float) -> Region:
    """The middle of a part, in whole pixels, at least so wide and high."""
    x, y, w, h = part
    left, top = max(int((w - width) / 2), 0), max(int((h - height) / 2), 0)
    return x + left, y + top, w - 2 * left, h - 2 * top
