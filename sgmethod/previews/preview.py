"""preview(): a picture as a short text, with the size and colour that a page needs."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from pathlib import Path
from urllib.parse import quote

import numpy as np

from sgmethod.arguments import AnyInt, checked_integer
from sgmethod.bitstream.text import from_text, to_text
from sgmethod.bitstream.v2 import SMALLEST_FILE
from sgmethod.budget import Budget
from sgmethod.codec import encode_as
from sgmethod.encode_arguments import EncodeArguments
from sgmethod.errors import BudgetError
from sgmethod.io.colour import from_srgb
from sgmethod.io.image import ImageLimits, Input
from sgmethod.numerics import quiet
from sgmethod.previews.reducing import reduced
from sgmethod.previews.still import webp_uri
from sgmethod.scene import Pixels
from sgmethod.settings.rd import EFFORTS, NEWTON_ADAM, RdSettings

DEFAULT_BYTES, MAX_BYTES = 200, 16_384
PIXELS_PER_BYTE, EFFORT = 256, 4  # docs/notebook/optimiser.md
# Least l1 and l3 of Gaussians, in pixels, up to this many bytes; less beyond. A soft blur is a better
# placeholder than sharp splinters, which squared error prefers (docs/notebook/eye.md).
SOFT_PX, SOFT_BYTES = 10.0, 200
DARK = 0.179  # relative luminance below which white contrasts more than black (WCAG 2, 1.4.3)
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
HTML_CHARACTERS = 500  # of a tag without JavaScript
# The two rules in docs/previews.md.
ELEMENT_STYLE = "display:grid;grid:minmax(0, 1fr) / minmax(0, 1fr);height:min-content"
IMG_STYLE = "display:block;min-width:100%;max-width:100%;height:100%;object-fit:cover"


@dataclass(frozen=True)
class Preview:
    """A picture in a few hundred characters.

    text: base64url of an .sg file, for the decoder for pages and sgmethod.from_text(); width, height: of the picture as
    displayed, in pixels; color: the average, "#rrggbb", weighted by opacity; dark: whether white text on it is easier
    to read than black.
    """

    text: str
    width: int
    height: int
    color: str
    dark: bool
    _pixels: Pixels = field(repr=False, compare=False)  # of the picture, reduced

    @cached_property
    def data(self) -> bytes:
        """The .sg file, of a smaller picture with about the same aspect ratio."""
        return from_text(self.text)

    def to_dict(self) -> dict[str, object]:
        """Return the fields as plain JSON types."""
        return {name: getattr(self, name) for name in ("text", "width", "height", "color", "dark")}

    def html(self, src: str, alt: str = "", characters: int = HTML_CHARACTERS) -> str:
        """Return an <img> that shows the picture as a small WebP until it has loaded, without JavaScript.

        The <img> is as wide as its container. The WebP is the best that keeps the tag within `characters` characters;
        if none does, there is the average colour. Where a page letterboxes the photograph, as by object-fit: contain,
        the WebP does not show beside it. A transparent picture has none, since the WebP would show through.
        src: the picture's URL, already quoted; alt: its alternative text.
        """
        return self._img(src, alt, "width:100%;height:auto", "contain", characters)

    def element(self, src: str, alt: str = "", characters: int = HTML_CHARACTERS) -> str:
        """Return an <sg-img>, as wide as its container, that draws the preview over the <img> inside it.

        The <img> is like html()'s, so its WebP is shown before the script has run, and without JavaScript. The styles
        also reserve the space; where a content security policy forbids them, the two rules in docs/previews.md do that.
        Arguments as in html(); characters limits the <img>.
        """
        image = self._img(src, alt, IMG_STYLE, "cover", characters)
        return f'<sg-img preview="{self.text}" style="{ELEMENT_STYLE}">{image}</sg-img>'

    def _img(self, src: str, alt: str, style: str, fit: str, characters: int) -> str:
        if self._pixels.shape[2] == 4:
            return self._tag(src, alt, style)
        drawn = f"{style};background:url({{}}) center / {fit} no-repeat"
        uri = webp_uri(self._pixels, characters - len(self._tag(src, alt, drawn.format(""))))
        return self._tag(src, alt, drawn.format(uri) if uri else f"{style};background:{self.color}")

    def _tag(self, src: str, alt: str, style: str) -> str:
        known = f'src="{escape(src)}" alt="{escape(alt)}" width="{self.width}" height="{self.height}"'
        return f'<img {known} loading="lazy" decoding="async" style="{style}">'


@quiet
def preview(image: Input, bytes: AnyInt | str = DEFAULT_BYTES, *, limits: ImageLimits | None = None) -> Preview:
    """Encode a picture as a text of a few hundred characters, for an attribute or a JSON string.

    >>> made = sgmethod.preview("photo.jpg")
    >>> made.width, made.height, len(made.text) <= 266
    (128, 96, True)

    image: as for encode(); transparency is kept; bytes: maximum size of the file, 12 to 16,384 (three bytes become
    four characters), or a string such as "1k"; limits: limits on image files.
    Raises ImageError, BudgetError, OSError and MemoryError, and warns with ImageWarning, as encode() does.
    """
    bytes = checked_bytes(bytes)
    pixels, (width, height) = reduced(image, PIXELS_PER_BYTE * bytes, limits)
    text = to_text(encode_as(_softened(pixels, bytes), pixels).data)
    color = average_of(pixels)
    light = from_srgb(np.array(color) / 255)
    hexadecimal = "#{:02x}{:02x}{:02x}".format(*color)
    return Preview(text, width, height, hexadecimal, bool(light @ LUMINANCE < DARK), pixels)


def checked_bytes(bytes: AnyInt | str) -> int:
    """Return the bytes of a preview as an int. Raises BudgetError for a number that no preview can have."""
    if isinstance(bytes, str):
        bytes = int(Budget("bytes", bytes).value)
    return checked_integer(bytes, "the bytes of a preview", SMALLEST_FILE, MAX_BYTES, BudgetError)


def _softened(pixels: Pixels, bytes: int) -> EncodeArguments:
    """Arguments for a reduced picture, or for a picture that was small already and so needs smaller Gaussians."""
    small = math.sqrt(pixels.shape[0] * pixels.shape[1] / (PIXELS_PER_BYTE * bytes))
    least = max(SOFT_PX * small * min(SOFT_BYTES / bytes, 1), NEWTON_ADAM.min_scale_px)
    asked = EncodeArguments.checked(Budget("bytes", bytes), "rd", "psnr", EFFORT)
    return replace(asked, settings=RdSettings(EFFORTS[EFFORT], replace(NEWTON_ADAM, min_scale_px=least)))


def average_of(pixels: Pixels) -> tuple[int, int, int]:
    """Average colour of pixels [H, W, 3], or of [H, W, 4] weighted by alpha."""
    flat = pixels.reshape(-1, pixels.shape[2]).astype(np.float64)
    weights = flat[:, 3] if flat.shape[1] == 4 and flat[:, 3].any() else np.ones(len(flat))
    red, green, blue = (round(float(level)) for level in weights @ flat[:, :3] / weights.sum())
    return red, green, blue


def quoted(path: str) -> str:
    """Quote a path as a relative URL; the name need not be valid text."""
    return quote(os.fsencode(Path(path).as_posix()))  # also ":", because "12:30.png" would be a URL of scheme "12"
