"""Decoding: bytes -> scene -> view of it -> 8-bit pixels. No torch here."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sgmethod.bitstream import container
from sgmethod.bitstream.stream import Info, Limits
from sgmethod.errors import BitstreamError
from sgmethod.native import native
from sgmethod.scene import Scene
from sgmethod.view import View

WHOLE = View()
MAX_PIXELS = 100_000_000  # 300 MB of output; a header can claim any size, memory cannot follow any


def decode(data: bytes, max_pixels: int = MAX_PIXELS, view: View = WHOLE) -> NDArray[np.uint8]:
    """The picture in an .sg file, or a view of it: [height, width, 3], 8-bit RGB.

    Raises BitstreamError for bytes that are not a whole, intact file, or a picture or view of more than max_pixels;
    ViewError for a view that makes no picture of it; MemoryError.
    """
    limits = Limits(max_pixels)
    scene = container.parse(data, limits).scene(view.prefix)
    limits.check_size(*view.size(scene.width, scene.height))
    return draw(view.apply(scene))


def draw(scene: Scene) -> NDArray[np.uint8]:
    """Pixels [height, width, 3]. They are the same on every instruction set and for every number of threads.

    Raises BitstreamError where the Gaussians overlap so much that drawing them would take unbounded time.
    """
    gaussians, width, height = scene.gaussians, scene.width, scene.height
    tiles = -(-width // native.TILE_WIDTH) * -(-height // native.TILE_HEIGHT)
    # Fitted pictures come to at most a fifth of this (six pictures from 0.03 to 12 bpp, noise and a constant among
    # them). A hostile file could make every Gaussian cover everything.
    max_pairs = 16 * len(gaussians) + 256 * tiles
    arrays = gaussians.means, gaussians.factors
    try:
        x, y = scene.origin
        raster = native.Rasterization(
            *arrays, width, height, scene.cutoff, max_pairs=max_pairs, pyramid=scene.pyramid, x=x, y=y
        )
    except OverflowError as error:
        raise BitstreamError("the file's Gaussians overlap beyond what a picture needs") from error
    pixels = np.empty((height, width, 3), np.uint8)
    red, green, blue = (level / 255 for level in scene.background)
    raster.render_bytes(gaussians.colors, pixels, (red, green, blue))
    return pixels


def info(data: bytes, max_gaussians: int | None = None) -> Info:
    """What an .sg file says of itself: every header field, and the bits spent on each part.

    Raises BitstreamError, also for more than max_gaussians, before memory is taken for them.
    """
    return container.info(data, Limits(max_gaussians=max_gaussians))
