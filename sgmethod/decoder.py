"""Decoding: bytes -> scene -> view of it -> 8-bit pixels. No torch here."""

from __future__ import annotations

import errno
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from sgmethod.arguments import AnyFloat, AnyInt, checked_integer
from sgmethod.bitstream import container
from sgmethod.bitstream.stream import OVERLAP, Info, Limits, Stream
from sgmethod.bitstream.text import file_of
from sgmethod.errors import BitstreamError, ViewError
from sgmethod.io.files import File, bytes_of
from sgmethod.native import native
from sgmethod.numerics import quiet
from sgmethod.scene import FloatArray, Gaussians, Scene
from sgmethod.view import View, recut

WHOLE = View()
MAX_LIMIT = 2**63 - 1
MAX_PIXELS = 100_000_000  # 300 MB of output, as many as ImageLimits reads: a damaged header may claim any size


@quiet
def decode(
    data: File,
    max_pixels: AnyInt = MAX_PIXELS,
    view: View = WHOLE,
    *,
    width: AnyInt | None = None,
    height: AnyInt | None = None,
) -> NDArray[np.uint8]:
    """Decode an .sg file, or a view of it, to 8-bit sRGB [height, width, 3], or [height, width, 4] with alpha.

    >>> sgmethod.decode("photo.sg").shape
    (96, 128, 3)
    >>> sgmethod.decode("photo.sg", width=64).shape
    (48, 64, 3)

    data: a file's path or bytes; width, height: pixels into which the picture or the view's region is fitted.
    Raises BitstreamError for a damaged file, and for a picture or view of more than max_pixels; ViewError for an
    invalid view; OSError for a path that cannot be read; MemoryError.
    """
    if isinstance(max_pixels, View):
        raise ViewError("the second argument of decode() is max_pixels: give a view by its name, view=View(...)")
    if not isinstance(view, View):
        raise ViewError(f"a view must be a sgmethod.View, not {type(view).__name__}")
    photo = SgFile(data, max_pixels)
    return photo._draw(view.within(photo.size, width, height))


@quiet
def info(data: File, max_gaussians: AnyInt | None = None) -> Info:
    """Read the header of an .sg file, and how its bits are spent.

    >>> sgmethod.info("photo.sg").width
    128

    data: a file's path or bytes.
    Raises BitstreamError for a damaged file, and for more than max_gaussians before allocating memory for them;
    OSError.
    """
    if max_gaussians is not None:
        max_gaussians = checked_integer(max_gaussians, "max_gaussians", 0, MAX_LIMIT)
    return container.info(_read(data), Limits(max_gaussians=max_gaussians))


def open(file: File) -> SgFile:
    """Open and check an .sg file, given its path or bytes. Raises BitstreamError and OSError."""
    return SgFile(file)


class SgFile:
    """An open .sg file, which draws any part at any size.

    >>> photo = sgmethod.open("photo.sg")
    >>> photo.size
    (128, 96)
    >>> photo.pixels(scale=0.5).shape
    (48, 64, 3)
    """

    @quiet
    def __init__(self, data: File, max_pixels: AnyInt = MAX_PIXELS) -> None:
        """Open and check a file.

        data: a file's path or bytes; max_pixels: limit for the picture and each view.
        Raises BitstreamError and OSError.
        """
        self._limits = Limits(checked_integer(max_pixels, "max_pixels", 0, MAX_LIMIT))
        self._data = _read(data)
        self._stream = container.parse(self._data, self._limits)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self._stream.width, self._stream.height

    @property
    def has_alpha(self) -> bool:
        """Whether the picture has transparency; pixels() then returns four channels."""
        return self._stream.alpha is not None

    @property
    def info(self) -> Info:
        """Header fields, and how the bits are spent."""
        return self._stream.info(len(self._data), container.checksum(self._data))

    @property
    def background(self) -> tuple[float, float, float]:
        """Colour below the Gaussians: red, green and blue in [0, 1]."""
        red, green, blue = self._stream.background
        return red / 255, green / 255, blue / 255

    @quiet
    def gaussians(self) -> Gaussians:
        """Return the Gaussians of the colours, without alpha and texture, in a file of profile rd the largest first.

        >>> sgmethod.open("photo.sg").gaussians().means.dtype
        dtype('float32')

        Gaussians of other profiles extend farther, and are converted to the closest ones of profile rd. Raises
        BitstreamError and MemoryError.
        """
        scene = self._stream.scene()
        return recut(scene.gaussians, scene.cutoff)

    @quiet
    def pixels(
        self,
        scale: AnyFloat = 1.0,
        region: Iterable[AnyInt] | None = None,
        prefix: AnyFloat = 1.0,
        texture: bool = True,
        *,
        width: AnyInt | None = None,
        height: AnyInt | None = None,
    ) -> NDArray[np.uint8]:
        """Draw the picture or a view of it: 8-bit sRGB [height, width, 3 or 4].

        scale, region, prefix, texture: see sgmethod.View; width, height: instead of a scale, pixels into which the
        picture is fitted.
        Raises ViewError for an invalid view, BitstreamError for one with too many pixels, and MemoryError.
        """
        return self._draw(View(scale, region, prefix, texture).within(self.size, width, height))

    def _draw(self, view: View) -> NDArray[np.uint8]:
        if view.prefix < 1:
            self._stream.scene()  # a file whose end is damaged is refused, whatever part is drawn
        if view.is_whole:
            return draw_whole(self._stream, view.prefix, view.texture)
        scene = self._stream.scene(view.prefix)
        self._limits.check_size(*view.size(scene.width, scene.height))
        return draw(view.apply(scene))

    def __repr__(self) -> str:
        width, height = self.size
        return f"<SgFile {width} x {height} pixels, {len(self._data):,} bytes>"


def _read(file: File) -> bytes:
    """Return the bytes of an .sg file, given its path or bytes, which may also hold its text."""
    try:
        return file_of(bytes_of(file, BitstreamError, "an .sg file"))
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            raise BitstreamError("no file has so long a name; sgmethod.from_text() reads a text") from error
        raise


def draw_whole(stream: Stream, prefix: float = 1.0, texture: bool = True) -> NDArray[np.uint8]:
    """Return draw(stream.scene(prefix)), in less time. Raises the same errors."""
    laid_out = stream.lay_out(prefix, texture)
    if laid_out is None:
        return draw(stream.scene(prefix))
    pixels = _picture(*laid_out, stream.background)
    return pixels if stream.alpha is None else _with_alpha(pixels, draw_whole(stream.alpha))


def draw(scene: Scene) -> NDArray[np.uint8]:
    """Draw pixels [height, width, 3 or 4], identical on every instruction set and for every number of threads.

    Raises BitstreamError if the Gaussians overlap so much that drawing them would take unbounded time.
    """
    pixels = _drawn(scene)
    return pixels if scene.alpha is None else _with_alpha(pixels, _drawn(scene.alpha))


def _drawn(scene: Scene) -> NDArray[np.uint8]:
    gaussians, size, (x, y) = scene.gaussians, (scene.width, scene.height), scene.origin
    t = scene.texture
    try:
        raster = native.Rasterization(
            gaussians.means,
            gaussians.factors,
            *size,
            scene.cutoff,
            max_pairs=native.max_pairs_of(len(gaussians), *size),
            pyramid=scene.pyramid,
            x=x,
            y=y,
            texture=None if t is None else native.Texture(t.codes, *t.cell, *t.corner, t.shift),
        )
    except OverflowError as error:
        raise BitstreamError(OVERLAP) from error
    return _picture(raster, gaussians.colors, scene.background)


def _picture(raster: native.Rasterization, colors: FloatArray, background: tuple[int, int, int]) -> NDArray[np.uint8]:
    pixels = np.empty((raster.height, raster.width, 3), np.uint8)
    red, green, blue = (level / 255 for level in background)
    raster.render_bytes(colors, pixels, (red, green, blue))
    return pixels


def _with_alpha(colours: NDArray[np.uint8], alpha: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Combine colours [height, width, 3] and a grey picture of alpha to [height, width, 4]."""
    return np.concatenate([colours, alpha[..., :1]], axis=2)
